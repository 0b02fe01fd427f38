"""The resident planner: an HTTP server on the standard library around one `GraspSynthesizer`."""

from __future__ import annotations

import hmac
import json
import logging
import socket
import threading
import urllib.parse
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from typing import Any

from megrasp_core.errors import InvalidRequestError, MegraspError, UnknownGripperError
from megrasp_core.grippers import Gripper, list_grippers
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.synthesizer import GraspSynthesizer

from .wire import cloud_of, options_in, request_of

__all__ = ["PlannerServer"]

LOGGER = logging.getLogger(__name__)
LARGEST_BODY = 512 * 2**20
"""Longer bodies are refused unread (bytes)."""
PATIENCE = 30.0
"""A client that sends nothing for so long is given up (s)."""
BUSY = 1
BUSY_TEXT = "the planner is at work for another request. Ask again."
LARGEST_DISCARDED = 64 * 2**20
"""So much of a refused body is read and thrown away, since many clients look at an answer only
after they have sent everything (bytes)."""


class PlannerServer:
    """Answers one synthesis at a time; another request meanwhile is told that it is busy.

        GET  /status
        POST /gripper              {"name": "franka_hand"}
        POST /synthesize?request=  a cloud file; options of `SynthesisRequest` as JSON, or "body"
            where they are in the array `request` of a .npz

    Grippers are named as in the registry, never by a path. Errors are
    {"error": {"code": ..., "message": ...}} with the codes of docs/ros.md.
    """

    def __init__(
        self,
        synthesizer: GraspSynthesizer,
        *,
        host: str = "127.0.0.1",
        port: int = 8741,
        token: str = "",
    ) -> None:
        """Listen; requests are answered from `serve` on.

        Args:
            synthesizer: with a model and a gripper.
            host: to listen on; others than loopback need a token.
            port: 0 takes a free one.
            token: that every request has to bring as "Authorization: Bearer TOKEN"; "": none.

        Raises:
            InvalidRequestError: the address is open to others without a token, or in use.
        """
        if not token and not _is_loopback(host):
            raise InvalidRequestError(
                f"host {host} was given without a token; expected a token on addresses that "
                "others can reach. Give --token, or stay on 127.0.0.1."
            )
        self._synthesizer = synthesizer
        self._token = token
        self._work = threading.Lock()
        try:
            self._http = _Listener((host, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InvalidRequestError(
                f"host {host} port {port} cannot be listened on ({error}). Give another port."
            ) from None
        self._http.planner = self

    @property
    def address(self) -> str:
        """Where it listens, as URL."""
        host, port = str(self._http.server_address[0]), self._http.server_address[1]
        return f"http://{f'[{host}]' if ':' in host else host}:{port}"

    def serve(self) -> None:
        """Answer requests until `stop`."""
        try:
            self._http.serve_forever(poll_interval=0.1)
        finally:
            self._http.server_close()

    def stop(self) -> None:
        """End `serve`, from another thread."""
        self._http.shutdown()

    # ------------------------------------------------------------ what clients ask

    def comes_from_a_page(self, origin: str | None) -> bool:
        """Whether a browser sends a request for a page of somebody else, which could press every
        button of a planner without a token.
        """
        return origin is not None and not self._token

    def check_free(self) -> None:
        """Say that the planner is busy before a body is read for nothing."""
        if self._work.locked():
            raise _Busy(BUSY_TEXT)

    def allows(self, authorization: str) -> bool:
        """Whether a request's Authorization header brings the token."""
        wanted = f"Bearer {self._token}"
        return not self._token or hmac.compare_digest(authorization.encode(), wanted.encode())

    def status(self) -> dict[str, Any]:
        """Model, mounted gripper, registered grippers, whether a synthesis runs."""
        gripper = self._synthesizer.gripper
        return {
            "model": self._synthesizer.model.model_id,
            "gripper": None if gripper is None else gripper.name,
            "grippers": list_grippers(),
            "busy": self._work.locked(),
        }

    def set_gripper(self, name: object) -> dict[str, Any]:
        """Mount a registered gripper."""
        names = list_grippers()
        if name not in names:
            raise UnknownGripperError(str(name)[:100], names)
        with self._one_at_a_time():
            return _describe(self._synthesizer.set_gripper(str(name)))

    def synthesize(self, body: bytes, options: dict[str, Any]) -> dict[str, Any]:
        """The content of grasps.json for a cloud file."""
        request = request_of(options)
        with self._one_at_a_time():
            return self._synthesizer.synthesize(cloud_of(body), request).to_json()

    def _one_at_a_time(self) -> _Turn:
        return _Turn(self._work)


class _Busy(MegraspError):
    code = BUSY


class _Turn:
    """Holds the planner, or says that it is busy."""

    def __init__(self, lock: threading.Lock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise _Busy(BUSY_TEXT)

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class _Listener(ThreadingHTTPServer):
    daemon_threads = True
    planner: PlannerServer

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.address_family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        super().__init__(address, handler)


class _Handler(BaseHTTPRequestHandler):
    server: _Listener  # type: ignore[assignment]
    timeout = PATIENCE
    protocol_version = "HTTP/1.1"
    _read = False

    def do_GET(self) -> None:
        self._answer("GET")

    def do_POST(self) -> None:
        self._answer("POST")

    def log_message(self, format: str, *args: object) -> None:
        LOGGER.debug("%s " + format, self.address_string(), *args)

    def _answer(self, method: str) -> None:
        self._read = False
        try:
            status, content = self._outcome(method)
        except MegraspError as error:
            busy = error.code == BUSY
            status = HTTPStatus.SERVICE_UNAVAILABLE if busy else HTTPStatus.BAD_REQUEST
            if busy and not self._read:
                self._discard()
            content = _error(error.code, str(error))
        except (ConnectionError, TimeoutError):
            self.close_connection = True
            return
        except Exception as error:  # one request must not end the planner
            LOGGER.exception("a request failed")
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            content = _error(MegraspError.code, f"{type(error).__name__}: {error}")
        self._send(status, content)

    def _outcome(self, method: str) -> tuple[HTTPStatus, dict[str, Any]]:
        planner = self.server.planner
        url = urllib.parse.urlsplit(self.path)
        if planner.comes_from_a_page(self.headers.get("Origin")):
            return self._refused(
                HTTPStatus.FORBIDDEN,
                "a page in a browser asks; expected a program. Start the planner with --token and "
                "let the page bring it.",
            )
        if not planner.allows(self.headers.get("Authorization", "")):
            return self._refused(
                HTTPStatus.UNAUTHORIZED,
                "the token is missing or wrong; expected 'Authorization: Bearer TOKEN'.",
            )
        if (method, url.path) == ("GET", "/status"):
            return HTTPStatus.OK, planner.status()
        if (method, url.path) == ("POST", "/gripper"):
            return HTTPStatus.OK, planner.set_gripper(_object(self._body()).get("name"))
        if (method, url.path) == ("POST", "/synthesize"):
            planner.check_free()
            given = urllib.parse.parse_qs(url.query).get("request", ["{}"])[0]
            body = self._body()
            options = _object(options_in(body) if given == "body" else given.encode())
            return HTTPStatus.OK, planner.synthesize(body, options)
        return self._refused(
            HTTPStatus.NOT_FOUND,
            f"there is no {method} {url.path[:100]}; expected GET /status, POST /gripper or POST "
            "/synthesize.",
        )

    def _refused(self, status: HTTPStatus, text: str) -> tuple[HTTPStatus, dict[str, Any]]:
        self._discard()
        return status, _error(5, text)

    def _discard(self) -> None:
        """Read a body that nobody wants; the connection ends with the answer."""
        self.close_connection = True
        text = self.headers.get("Content-Length", "")
        left = min(int(text), LARGEST_DISCARDED) if text.isdecimal() else 0
        while left > 0 and (part := self.rfile.read(min(left, 2**16))):
            left -= len(part)

    def _body(self) -> bytes:
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            length = -1
        if not 0 <= length <= LARGEST_BODY:
            self.close_connection = True
            raise InvalidRequestError(
                f"Content-Length is {self.headers.get('Content-Length')}; expected 0 to "
                f"{LARGEST_BODY} bytes."
            )
        self._read = True
        body = self.rfile.read(length)
        if len(body) < length:
            raise ConnectionError("the client went away")
        return body

    def _send(self, status: HTTPStatus, content: dict[str, Any]) -> None:
        body = json.dumps(content, allow_nan=False).encode()
        try:
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
        except (ConnectionError, TimeoutError):
            self.close_connection = True


def _object(text: bytes) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InvalidRequestError(
            f"{text[:100].decode(errors='replace')!r} is no JSON object; expected one, such as "
            '{"num_grasps": 5}.'
        )
    return content


def _error(code: int, message: str) -> dict[str, Any]:
    return {"error": {"code": code, "message": message}}


def _describe(gripper: Gripper) -> dict[str, Any]:
    return {
        "name": gripper.name,
        "display_name": gripper.description.display_name,
        "kind": gripper.description.kind,
        "gripper_from_tcp": pose7_from_matrix(gripper.gripper_from_tcp).tolist(),
        "open": gripper.open_joints,
        "closed": gripper.closed_joints,
    }


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

"""Client of the resident planner, with nothing but the standard library and numpy."""

from __future__ import annotations

import io
import json
import urllib.error
import urllib.parse
import urllib.request
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["PlannerClient", "PlannerError"]

LONGEST_QUERY = 8000
"""Longer options travel in the body: servers and proxies cut addresses (characters)."""


class PlannerError(Exception):
    """The planner refused or failed.

    code: as in docs/ros.md, 0 where nobody answered. The text says what was given, what was
    expected and what to do.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class PlannerClient:
    """Asks a planner that `megrasp serve` runs.

    The gripper stays until another one is set:

        planner = PlannerClient("http://127.0.0.1:8741")
        planner.set_gripper("franka_hand")
        answer = planner.synthesize(points, sensor=[0, 0, 0.8], num_grasps=5)
        best = answer["grasps"][0]["world_from_gripper"]
    """

    def __init__(
        self, address: str = "http://127.0.0.1:8741", token: str = "", timeout: float = 120.0
    ) -> None:
        """Take address and token that `megrasp serve` printed, and the longest wait (s)."""
        self._address, self._token, self._timeout = address.rstrip("/"), token, timeout

    def synthesize(
        self,
        points: ArrayLike,
        *,
        labels: ArrayLike | None = None,
        **options: Any,
    ) -> dict[str, Any]:
        """Ranked grasps, the content of grasps.json.

        Args:
            points: (N, 3) metres; float32 goes as it is, all else as float64.
            labels: (N,) objects of a mask.
            options: of `SynthesisRequest`; arrays become lists, and a `sensor` (N, 3) the cloud's
                viewpoint.

        Raises:
            PlannerError: a bad request, a busy planner, or nobody there.
        """
        given = np.asarray(points)
        # Places on a map have seven digits before the millimetres.
        arrays = {"points": given if given.dtype == np.float32 else given.astype(np.float64)}
        if labels is not None:
            arrays["labels"] = np.asarray(labels, dtype=np.int32)
        sensor = options.get("sensor")
        if sensor is not None and np.ndim(sensor) == 2:
            arrays["viewpoint"] = np.asarray(options.pop("sensor"), dtype=np.float64)
        text = json.dumps({name: _plain(value) for name, value in options.items()})
        query = urllib.parse.urlencode({"request": text})
        if len(query) > LONGEST_QUERY:
            arrays["request"] = np.frombuffer(text.encode(), dtype=np.uint8)
            query = "request=body"
        body = io.BytesIO()
        np.savez(body, **arrays)  # type: ignore[arg-type]
        return self._send(f"/synthesize?{query}", body.getvalue())

    def set_gripper(self, name: str) -> dict[str, Any]:
        """Mount a gripper of the registry; answers its frames and postures."""
        return self._send("/gripper", json.dumps({"name": name}).encode())

    def status(self) -> dict[str, Any]:
        """Model, gripper that is on, grippers that there are, whether the planner is busy."""
        return self._send("/status")

    def _send(self, path: str, body: bytes | None = None) -> dict[str, Any]:
        request = urllib.request.Request(self._address + path, data=body)
        if self._token:
            request.add_header("Authorization", f"Bearer {self._token}")
        try:
            with urllib.request.urlopen(request, timeout=self._timeout) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            try:
                told = json.load(error)["error"]
            except (ValueError, KeyError):
                told = {"code": 0, "message": f"{self._address} answered {error.code}"}
            raise PlannerError(told["code"], told["message"]) from None
        except OSError as error:
            raise PlannerError(
                0, f"no planner answers at {self._address} ({error}). Is `megrasp serve` running?"
            ) from None


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value

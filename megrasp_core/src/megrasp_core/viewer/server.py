"""The web server that a viewer draws into, and how its page is reached."""

from __future__ import annotations

import contextlib
import getpass
import io
import socket
from typing import TYPE_CHECKING

from megrasp_core.errors import InvalidRequestError, MissingPackageError

if TYPE_CHECKING:
    from viser import ViserServer

__all__ = ["LOOPBACK", "how_to_reach", "open_server"]

LOOPBACK = "127.0.0.1"
"""Only programs of this machine reach it, and there is no login."""


def open_server(host: str = LOOPBACK, port: int = 8080) -> ViserServer:
    """Start serving an empty page; `stop()` ends it.

    Args:
        host: address to listen at. At other addresses than loopback anybody who reaches the
            machine can press every button.
        port: the next free one is taken where it is in use; 0: any.

    Raises:
        MissingPackageError: viser is not installed.
        InvalidRequestError: the address cannot be listened at.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingPackageError("viser", "view", "a viewer in the browser") from error
    # viser looks for a free port in a thread of its own, where an address that is not ours would
    # be met as if it were a port in use.
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind((host, 0))
    except (OSError, OverflowError) as error:
        raise InvalidRequestError(
            f"the address {host} port {port} cannot be listened at ({error}); expected an address "
            f"of this machine, such as {LOOPBACK}, and a port from 0 to 65535."
        ) from error
    # It also greets on standard output, which belongs to the program.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    server.gui.configure_theme(control_width="large", dark_mode=False, show_logo=False)
    return server


def how_to_reach(server: ViserServer) -> list[str]:
    """Lines for the user: the address of the page, and from another machine where needed."""
    host, port = server.get_host(), server.get_port()
    shown = socket.gethostname() if host in ("0.0.0.0", "::", "") else host
    lines = [f"open http://{shown}:{port}"]
    if host in (LOOPBACK, "localhost", "::1"):
        lines.append(
            f"from another machine: ssh -L {port}:{host}:{port} {getpass.getuser()}@"
            f"{socket.gethostname()}, then open http://localhost:{port}"
        )
    return lines

"""`megrasp serve`."""

from __future__ import annotations

import secrets
import signal
import threading

from megrasp_core.errors import InvalidRequestError

from .common import say

__all__ = ["serve"]


def serve(
    gripper: str,
    port: int = 8741,
    host: str = "127.0.0.1",
    token: str | None = None,
    model: str | None = None,
    device: str = "cpu",
    threads: int | None = None,
) -> int:
    """A resident planner over HTTP, for programs without ROS.

    Only this machine can reach it unless --host says otherwise; then a token is needed, which is
    made up and printed where none is given.

    Try:
      megrasp serve --gripper franka_hand
      curl --data-binary @bin.npz 'http://127.0.0.1:8741/synthesize?request=%7B%22num_grasps%22:5%7D'
      megrasp serve --gripper robotiq_2f85 --host 0.0.0.0 --port 9000

    Args:
        gripper: the one that is on at the start: a registered name or the folder of a
            gripper.yaml.
        port: to listen on; 0 takes a free one.
        host: address to listen on.
        token: that clients have to bring.
        model: id or folder; the default for the kind of the gripper without it.
        device: cpu or cuda.
        threads: torch threads; as the process has them without it.
    """
    if not 0 <= port <= 65535:
        raise InvalidRequestError(f"--port {port} was given; expected 0 to 65535.")
    from megrasp_core.service import PlannerServer
    from megrasp_core.synthesizer import GraspSynthesizer

    outside = host not in ("127.0.0.1", "localhost", "::1")
    word = token if token is not None else secrets.token_urlsafe(16) if outside else ""
    synthesizer = GraspSynthesizer.load(model, gripper, device=device, threads=threads)
    server = PlannerServer(synthesizer, host=host, port=port, token=word)
    say(f"{synthesizer.model.model_id} plans for {gripper} at {server.address}")
    if outside and token is None:
        say(f"token: {word}")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=server.stop).start())
    server.serve()
    return 0

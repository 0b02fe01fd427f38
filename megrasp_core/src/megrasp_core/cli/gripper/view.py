"""`megrasp gripper view`."""

from __future__ import annotations

import tempfile
from pathlib import Path

import tyro

from megrasp_core.cli.common import say
from megrasp_core.cli.view import serve

__all__ = ["view"]


def view(
    gripper: tyro.conf.Positional[str],
    out: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Look at a gripper in a browser: frame, TCP, postures, pads; Ctrl-C ends it.

    Of a URDF or MJCF what the wizard of `gripper new` finds is shown, to be corrected by hand. The
    page hands the corrected gripper.yaml out, or writes it into --out.

    Try:
      megrasp gripper view robotiq_3f
      megrasp gripper view my_gripper.urdf --out grippers/my_gripper

    Args:
        gripper: registered name, folder of a gripper.yaml, or a URDF or MJCF.
        out: folder that the corrected gripper.yaml is written into: of a model a new one.
        host: address to listen at; there is no login.
        port: the next free one where it is in use.
    """
    from megrasp_core.grippers import MODEL_SUFFIXES, load_gripper
    from megrasp_core.viewer import GripperViewer, open_server

    server = open_server(host, port)
    path = Path(gripper)
    try:
        with tempfile.TemporaryDirectory(prefix="megrasp_view_") as scratch:
            findings: list[str] = []
            if path.suffix.lower() in MODEL_SUFFIXES and path.is_file():
                folder = out or Path(scratch) / path.stem
                findings = _made(path, folder)
                gripper = str(folder)
            GripperViewer(server, load_gripper(gripper), findings=findings, folder=out)
            serve(server)
    finally:
        server.stop()
    return 0


def _made(model: Path, folder: Path) -> list[str]:
    """Let the wizard make a gripper; returns what it found, line by line."""
    from megrasp_core.gripper_tools.wizard.findings import show
    from megrasp_core.gripper_tools.wizard.wizard import ModelRequest, new_gripper

    say(f"looking at {model}")
    made = new_gripper(ModelRequest(model=model, out=folder))
    found = [
        f"**{finding.what}**: {show(finding.value)} ({finding.sureness}: {finding.why})"
        for finding in made.findings
    ]
    return [*found, *made.notes, *made.warnings, *made.errors]

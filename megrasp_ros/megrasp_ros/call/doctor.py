"""`megrasp_call doctor`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from megrasp_core.cli.common import emit, say
from megrasp_ros.client import GraspClient

from .checks import machine
from .checks.check import Check

if TYPE_CHECKING:
    from .checks.asked import Asked

__all__ = ["doctor"]


def doctor(
    namespace: str = "",
    server: str = "grasp_server",
    points: str = "points",
    seconds: float = 3.0,
    timeout: float = 10.0,
    out: Path | None = None,
) -> int:
    """Look at everything that a request needs, and say what to change; a line each.

    Try:
      megrasp_call doctor
      megrasp_call doctor --points /camera/camera/depth/color/points --seconds 5
      megrasp_call doctor --namespace /cell_2 --out doctor.json

    Args:
        namespace: of the server.
        server: name of its node.
        points: topic that clouds are expected on, where no server tells its own.
        seconds: how long topics are listened to.
        timeout: longest wait (s) for nodes to be found and for answers.
        out: file with the lines (JSON).

    Returns:
        1 if a line says fail.
    """
    from .checks.asked import Asked

    checks = [
        machine.packages(machine.installed_versions()),
        machine.interfaces(),
        machine.shared_memory(),
        *machine.discovery(os.environ),
    ]
    name = f"megrasp_doctor_{os.getpid()}"
    with GraspClient.open(name, namespace=namespace, timeout=timeout) as client:
        asked = Asked(client, server, seconds=seconds, patience=timeout)
        running, cloud_bytes = running_system(asked, points)
    checks.append(machine.profile(os.environ, cloud_bytes=cloud_bytes))
    checks += running
    for check in checks:
        say(check.line())
    if out is not None:
        emit([vars(check) for check in checks], out)
    failed = sum(check.level == "fail" for check in checks)
    say(f"{failed} of {len(checks)} have to be changed" if failed else "nothing has to be changed")
    return 1 if failed else 0


def running_system(asked: Asked, points: str) -> tuple[list[Check], int]:
    """What the server, its input and its listeners are like, in the order in which a request would
    meet what is wrong; and the size of the largest message (bytes) that the camera sent.

    points: topic that clouds are expected on where no server tells its own.
    """
    from .checks.geometry import geometry
    from .checks.input import InputChecks
    from .checks.listeners import listeners
    from .checks.server import health, parameters, presence

    there, count = presence(asked)
    found, told, settings = [there], {}, None
    if count == 1:
        # Also of one that is not active: it says why.
        line, told = health(asked)
        found.append(line)
    if there.level != "fail":
        line, settings = parameters(asked)
        found.append(line)
    camera = InputChecks(asked, points, told, settings)
    found += camera.run()
    if settings is not None and camera.scene is not None:
        found += geometry(asked, settings, camera.scene)
    if there.level != "fail":
        found += listeners(asked.node)
    return found, camera.cloud_bytes

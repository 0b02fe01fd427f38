"""`megrasp_call doctor`."""

from __future__ import annotations

import os
from pathlib import Path

from megrasp_core.cli.common import emit, say
from megrasp_ros.client import GraspClient

from . import machine_checks as machine

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
    from .server_checks import ServerChecks

    checks = [
        machine.packages(machine.installed_versions()),
        machine.interfaces(),
        machine.shared_memory(),
        *machine.discovery(os.environ),
    ]
    name = f"megrasp_doctor_{os.getpid()}"
    with GraspClient.open(name, namespace=namespace, timeout=timeout) as client:
        asked = ServerChecks(client, server, points, seconds, timeout)
        running = asked.run()
    checks.append(machine.profile(os.environ, cloud_bytes=asked.cloud_bytes))
    checks += running
    for check in checks:
        say(check.line())
    if out is not None:
        emit([vars(check) for check in checks], out)
    failed = sum(check.level == "fail" for check in checks)
    say(f"{failed} of {len(checks)} have to be changed" if failed else "nothing has to be changed")
    return 1 if failed else 0

"""The speed of grasp_server, measured by a program of the ROS package in a process of its own; the
core knows no ROS.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from megrasp_core.errors import InvalidRequestError, MegraspError

__all__ = ["bench_ros", "find_bench_node"]

PROGRAM = Path("lib/megrasp_ros/bench_node")


def find_bench_node(prefixes: str | None = None) -> Path:
    """Return the program.

    Args:
        prefixes: folders with a colon between; by default AMENT_PREFIX_PATH.

    Raises:
        InvalidRequestError: the workspace is not sourced.
    """
    text = os.environ.get("AMENT_PREFIX_PATH", "") if prefixes is None else prefixes
    for prefix in text.split(os.pathsep):
        if prefix and (Path(prefix) / PROGRAM).is_file():
            return Path(prefix) / PROGRAM
    raise InvalidRequestError(
        "--stage ros was given, and no folder of AMENT_PREFIX_PATH has the program "
        f"{PROGRAM}; expected the workspace to be sourced. Build it with bash "
        "launch_scripts/setup.sh, then `. launch_scripts/env.sh`, and call again."
    )


def bench_ros(*, repeats: int, note: str) -> dict[str, Any]:
    """Return what the program measures; its progress goes to standard error.

    Args:
        repeats: timed requests per row.
        note: what else the machine was doing.

    Raises:
        InvalidRequestError: the workspace is not sourced.
        MegraspError: the program failed.
    """
    program = find_bench_node()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "ros_bench.json"
        command = [str(program), "--repeats", str(repeats), "--note", note, "--out", str(out)]
        code = subprocess.run(command, check=False).returncode
        if code or not out.is_file():
            raise MegraspError(
                f"{program.name} ended with exit code {code}; expected 0. What it wrote above "
                "says why."
            )
        return json.loads(out.read_text())

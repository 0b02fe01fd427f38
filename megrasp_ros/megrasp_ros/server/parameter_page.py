"""The tables of names, error codes and parameters in docs/ros.md.

python -m megrasp_ros.server.parameter_page docs/ros.md
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from megrasp_core.cli.common import block_writer

from .names import NAMES
from .parameter_table import TABLE

MARK = "parameters"


def table() -> str:
    """Every parameter of grasp_server with its default, range and description."""
    lines = ["| name | default | |", "| --- | --- | --- |"]
    for name, spec in TABLE.items():
        words = spec.description.replace("|", "\\|")
        if spec.low is not None and spec.high is not None:
            words += f"; {spec.low:g} to {spec.high:g}"
        lines.append(f"| `{name}` | `{json.dumps(spec.default)}` | {words} |")
    return "\n".join(lines) + "\n"


def name_table() -> str:
    """Every topic, service and action of grasp_server."""
    lines = ["| name | type | |", "| --- | --- | --- |"]
    for name, about in NAMES.items():
        heard = " (in)" if about.heard else ""
        kind = re.sub("/(msg|srv|action)/", "/", about.kind)
        lines.append(f"| `{name}`{heard} | {kind} | {about.text} |")
    return "\n".join(lines) + "\n"


def error_table() -> str:
    """Every error code, as the interface file has it."""
    file = Path(get_package_share_directory("megrasp_msgs")) / "msg" / "ErrorCode.msg"
    rows = re.findall(r"^uint16 (\w+)=(\d+) *# *(.+)$", file.read_text(), re.MULTILINE)
    lines = ["| code | constant | |", "| --- | --- | --- |"]
    lines += [f"| {number} | `{name}` | {text} |" for name, number, text in rows]
    return "\n".join(lines) + "\n"


TABLES = {"names": name_table, "errors": error_table, MARK: table}
"""Mark in the page -> what makes the table."""


if __name__ == "__main__":
    for mark, make in TABLES.items():
        block_writer(Path(sys.argv[1]), mark)(make())

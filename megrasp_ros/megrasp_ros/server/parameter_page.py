"""The table of parameters in docs/ros.md.

python -m megrasp_ros.server.parameter_page docs/ros.md
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from megrasp_core.cli.common import block_writer

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


if __name__ == "__main__":
    block_writer(Path(sys.argv[1]), MARK)(table())

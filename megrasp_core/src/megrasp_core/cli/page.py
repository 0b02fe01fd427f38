"""The table of commands in docs/cli.md: `python -m megrasp_core.cli.page docs/cli.md`."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path

from .commands import COMMANDS
from .common import block_writer

MARK = "commands"


def table() -> str:
    """Every command and the first sentence of what it says of itself."""
    lines = ["| command | does |", "| --- | --- |"]
    for name, entry in COMMANDS.items():
        members = {"": entry} if not isinstance(entry, tuple) else entry[1]
        for member, function in members.items():
            does = (inspect.getdoc(function) or "").split("\n\n")[0].replace("\n", " ")
            lines.append(f"| `megrasp {name}{' ' if member else ''}{member}` | {does} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    block_writer(Path(sys.argv[1]), MARK)(table())

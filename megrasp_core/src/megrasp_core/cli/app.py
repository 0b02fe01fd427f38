"""Registration of the commands, exit codes, messages.

Every command lies in a file of its own and imports what it needs when it runs, so that `megrasp
--help` is fast.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence

from megrasp_core.errors import (
    CancelledError,
    MegraspError,
    RequestTimeoutError,
    SimulationError,
    TrainingError,
)

from . import commands

__all__ = ["main"]

DESCRIPTION = """Grasp synthesis for bin picking with any gripper.

Try: megrasp demo
     megrasp synthesize cloud.ply --gripper robotiq_2f85 --out grasps.json --picture grasps.png

Exit codes: 0 done; 1 ran, but found nothing or failed; 2 bad input."""

FAILURES = (CancelledError, RequestTimeoutError, SimulationError, TrainingError)
"""Errors that are not about the input."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        args: arguments without the program's name; None: those of the process.
    """
    logging.basicConfig(level=logging.WARNING, format="megrasp: %(message)s", stream=sys.stderr)
    try:
        return int(commands.app().cli(prog="megrasp", description=DESCRIPTION, args=args) or 0)
    except SystemExit as leave:
        # The parser has already said what is wrong, or has printed the help.
        return leave.code if isinstance(leave.code, int) else 2
    except MegraspError as error:
        sys.stderr.write(f"megrasp: {error}\n")
        return 1 if isinstance(error, FAILURES) else 2
    except OSError as error:
        sys.stderr.write(f"megrasp: {error}; expected a path that can be read or written.\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("megrasp: stopped\n")
        return 1

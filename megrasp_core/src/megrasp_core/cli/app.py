"""Registration of the commands, exit codes, messages.

Every command lies in a file of its own and imports what it needs when it runs, so that `megrasp
--help` is fast.
"""

from __future__ import annotations

import logging
import os
import select
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

    Where whoever reads the output has closed it (`megrasp ... | head`), the command ends without
    a word and with exit code 1.

    Args:
        args: arguments without the program's name; None: those of the process.
    """
    for stream in ("stdout", "stderr"):
        # Closed before the command began (`>&-`).
        if getattr(sys, stream) is None:
            setattr(sys, stream, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    logging.basicConfig(level=logging.WARNING, format="megrasp: %(message)s", stream=sys.stderr)
    try:
        code = _run(args)
        sys.stdout.flush()
    except BrokenPipeError as error:
        if _output_closed():
            _drop_output()
        else:
            sys.stderr.write(f"megrasp: {error}; a process that it worked with has ended.\n")
        return 1
    except OSError as error:
        sys.stderr.write(f"megrasp: {error}; expected a path that can be read or written.\n")
        return 2
    return code


def _run(args: Sequence[str] | None) -> int:
    try:
        return int(commands.app().cli(prog="megrasp", description=DESCRIPTION, args=args) or 0)
    except SystemExit as leave:
        # The parser has already said what is wrong, or has printed the help.
        return leave.code if isinstance(leave.code, int) else 2
    except MegraspError as error:
        sys.stderr.write(f"megrasp: {error}\n")
        return 1 if isinstance(error, FAILURES) else 2
    except KeyboardInterrupt:
        sys.stderr.write("megrasp: stopped\n")
        return 1


def _output_closed() -> bool:
    """Whether nobody reads standard output any more."""
    try:
        watch = select.poll()
        watch.register(sys.stdout.fileno(), 0)
    except (OSError, ValueError):
        # A stream of a program that embeds the command, without a file.
        return False
    return bool(watch.poll(0))


def _drop_output() -> None:
    """What standard output still holds goes nowhere, or Python would complain at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)

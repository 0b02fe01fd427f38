"""Units of work for the executor tests; imports nothing heavy, since every process imports it."""

from __future__ import annotations

import os
import threading
from pathlib import Path


def square(unit: int) -> int:
    """Fail on 3."""
    if unit == 3:
        raise ValueError("three is not wanted")
    return unit * unit


def die_on_three(unit: int) -> int:
    """End the process on 3 as a kill does."""
    if unit == 3:
        os._exit(9)
    return unit


def die_once(unit: int, folder: str) -> int:
    """End the process the first time unit 3 is tried."""
    mark = Path(folder) / "died"
    if unit == 3 and not mark.exists():
        mark.touch()
        os._exit(9)
    return unit


def thread_setting(_: int) -> tuple[str | None, bool]:
    """Threads asked for in this process, and whether it is another one than the tests'."""
    return os.environ.get("OMP_NUM_THREADS"), threading.main_thread().name == "MainThread"

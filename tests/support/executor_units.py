"""Units of work for the executor tests; imports nothing heavy, since every process imports it."""

from __future__ import annotations

import os
import threading
import time
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


def slow(unit: object, seconds: float) -> object:
    """Take some time."""
    time.sleep(seconds)
    return unit


def killer_and_slow(unit: int) -> int:
    """End the process on 0, at once; all others take a while."""
    if unit == 0:
        os._exit(9)
    time.sleep(0.5)
    return unit


def late_last(unit: int, folder: str) -> int:
    """Leave the number of the process behind; 0 and 1 never in the same one, 2 takes a while."""
    (Path(folder) / f"{unit}.writing").write_text(str(os.getpid()))
    (Path(folder) / f"{unit}.writing").rename(Path(folder) / str(unit))
    while not (Path(folder) / "0").exists() or not (Path(folder) / "1").exists():
        time.sleep(0.01)
    time.sleep(1.5 if unit == 2 else 0.0)
    return unit

"""Calls that may block for ever, such as reading a path somebody sent, with a time limit."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

SLICE = 0.1
"""How often `while_waiting` is called (s)."""


class StillRunningError(Exception):
    """The call had not ended in time."""


def bounded(
    call: Callable[[], T], seconds: float, while_waiting: Callable[[], None] | None = None
) -> T:
    """Return what `call` returns or raise what it raises, after at most `seconds`.

    It runs in a thread of its own, which stays behind when it does not end; StillRunningError is
    raised then. `while_waiting` may raise to give up earlier.
    """
    outcome: list[T] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            outcome.append(call())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, name="bounded", daemon=True)
    thread.start()
    end = time.monotonic() + seconds
    while thread.is_alive() and time.monotonic() < end:
        thread.join(min(SLICE, max(0.0, end - time.monotonic())))
        if while_waiting is not None and thread.is_alive():
            while_waiting()
    if errors:
        raise errors[0]
    if not outcome:
        raise StillRunningError(f"the call had not ended after {seconds:g} s")
    return outcome[0]

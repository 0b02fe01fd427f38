"""Ctrl-C and SIGTERM during a run: they end it, but never in the middle of saving a result."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what batch systems send when the time is up."""


class StopSignals:
    """While entered, both signals raise KeyboardInterrupt, within `held_back` at its end.

    Where another handler than Python's own is installed, it stays: a program that embeds the core
    decides for itself. So it does in threads other than the main one, which get no signals.

    Attributes:
        received: what came, in words, "" before.
    """

    def __init__(self) -> None:
        self.received = ""
        self._holding = self._pending = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopSignals:
        usual = (signal.default_int_handler, signal.SIG_DFL)
        if threading.current_thread() is threading.main_thread():
            self._before = {s: h for s in STOPPING if (h := signal.getsignal(s)) in usual}
            self.install()
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def install(self) -> None:
        """Again, after something else has put its own handlers in the place of these."""
        for number in self._before:
            signal.signal(number, self._receive)

    @contextmanager
    def held_back(self) -> Iterator[None]:
        """A signal that comes within takes effect at the end; a second one takes it at once."""
        self._holding = True
        try:
            yield
        finally:
            self._holding = False
        if self._pending:
            raise KeyboardInterrupt

    def _receive(self, number: int, _: FrameType | None) -> None:
        self.received = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        if self._holding and not self._pending:
            self._pending = True
        else:
            raise KeyboardInterrupt


@contextmanager
def deaf_to_ctrl_c() -> Iterator[None]:
    """Processes started within never see Ctrl-C.

    A terminal sends it to every process of the group, but only the one that saves the results
    shall act on it; it ends the others. They stay open to SIGTERM, by which a pool ends them.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

"""Answers to many requests at once, not faster than a client takes them.

Clients of rclpy and rclcpp keep ten answers that they have not looked at yet; further ones push
out the earliest without a word. A server that refuses fifty requests in a few milliseconds would
leave forty clients waiting for ever.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from .waiting import wake_when

BURST = 6
"""So many answers go out at once, and then"""

GAP = 0.02
"""one after this time (s) each;"""

QUIET = 0.1
"""but none before no request has come for so long (s): who sends does not take answers;"""

PATIENCE = 10.0
"""all the same, none waits for that longer than this (s)."""


class Gate:
    """Lets callers pass, in their order."""

    def __init__(self, burst: int = BURST, gap: float = GAP, quiet: float = QUIET) -> None:
        self._burst, self._gap, self._quiet = burst, gap, quiet
        self._lock = threading.Lock()
        self._free_at = self._last = float("-inf")
        self._queue: deque[tuple[float, Callable[[], None]]] = deque()
        self._draining = False

    def enter(self, passed: Callable[[], None]) -> None:
        """Call `passed` at once or, by another thread, when it is the caller's turn."""
        now = time.monotonic()
        with self._lock:
            self._last = now
            self._free_at = max(self._free_at, now - self._burst * self._gap) + self._gap
            if self._draining or self._free_at > now:
                self._queue.append((now, passed))
                if not self._draining:
                    self._draining = True
                    threading.Thread(target=self._drain, name="gate", daemon=True).start()
                return
        passed()

    def _drain(self) -> None:
        while True:
            time.sleep(self._gap)
            with self._lock:
                if not self._queue:
                    self._draining = False
                    return
                now = time.monotonic()
                entered, passed = self._queue[0]
                if now - self._last < self._quiet and now - entered < PATIENCE:
                    continue
                self._queue.popleft()
            passed()


def paced(callback: Callable[[Any, Any], Any], node: Node) -> Callable[[Any, Any], Any]:
    """Wrap the callback of a service, plain or a coroutine, so that its answers pass a gate."""
    gate = Gate()

    async def answer(request: Any, response: Any) -> Any:
        answered = callback(request, response)
        if inspect.isawaitable(answered):
            answered = await answered
        await wake_when(gate.enter, node)
        return answered

    return answer

"""Threads that take turns: one runs at a time, and who is next is drawn from a seed."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Sequence


class Turns:
    """Runs functions in threads of their own; each calls `give` where another may go on.

    Between two calls nothing else runs, so that a seed gives the same interleaving on any machine.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self._condition = threading.Condition()
        self._waiting: set[int] = set()
        self._turn: int | None = None
        self._local = threading.local()
        self._errors: list[BaseException] = []

    def run(self, tasks: Sequence[Callable[[], None]]) -> None:
        """Run all; raise the first error of one."""
        self._waiting = set(range(len(tasks)))
        threads = [
            threading.Thread(target=self._task, args=(i, task)) for i, task in enumerate(tasks)
        ]
        for thread in threads:
            thread.start()
        with self._condition:
            self._pass_on()
        for thread in threads:
            thread.join()
        if self._errors:
            raise self._errors[0]

    def give(self) -> None:
        """Let somebody else, or the caller again, go on."""
        number: int = self._local.number
        with self._condition:
            self._waiting.add(number)
            self._pass_on()
            self._wait_for(number)

    def _task(self, number: int, task: Callable[[], None]) -> None:
        self._local.number = number
        with self._condition:
            self._wait_for(number)
        try:
            task()
        except BaseException as error:
            self._errors.append(error)
        with self._condition:
            self._pass_on()

    def _wait_for(self, number: int) -> None:
        self._condition.wait_for(lambda: self._turn == number)
        self._waiting.discard(number)

    def _pass_on(self) -> None:
        self._turn = self.random.choice(sorted(self._waiting)) if self._waiting else None
        self._condition.notify_all()

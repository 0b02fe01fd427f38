"""Units of work in processes of this machine; a process that dies costs nothing but time."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from .stopping import deaf_to_ctrl_c
from .worker import end_with_parent

U = TypeVar("U")
R = TypeVar("R")

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def pool_outcomes(
    function: Callable[[U], R], units: Sequence[U], workers: int, attempts: int
) -> Generator[tuple[U, R | None, str | None], None, None]:
    """(unit, result, None) or (unit, None, why it failed) of every unit, as they finish.

    When a process is killed the pool breaks: it is built again, and what was in flight is
    repeated. Which of those units killed its process is not known, so each goes alone then: one
    that always kills its process takes no other with it.
    """
    queue = [(unit, 1) for unit in reversed(units)]
    with _one_thread_each():
        while queue:
            pool = ProcessPoolExecutor(
                workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=end_with_parent,
            )
            flight: dict[Future[R], tuple[U, int]] = {}
            broken = clean = False
            try:
                while (queue or flight) and not broken:
                    while queue and len(flight) < workers:
                        unit, attempt = queue[-1]
                        alone = attempt > 1 or any(a > 1 for _, a in flight.values())
                        if flight and alone:
                            break
                        try:
                            with deaf_to_ctrl_c():
                                future = pool.submit(function, unit)
                        except BrokenProcessPool:
                            broken = True
                            break
                        queue.pop()
                        flight[future] = (unit, attempt)
                    finished, _ = wait(flight, return_when=FIRST_COMPLETED)
                    for future in finished:
                        error = future.exception()
                        if isinstance(error, BrokenProcessPool):
                            broken = True
                            continue
                        unit, _ = flight.pop(future)
                        if error is not None:
                            yield unit, None, describe(error)
                        else:
                            yield unit, future.result(), None
                for unit, attempt in flight.values():
                    if attempt < attempts:
                        queue.append((unit, attempt + 1))
                    else:
                        yield unit, None, f"its process died {attempt} times"
                clean = True
            finally:
                _shut_down(pool, wait_for_units=clean)


def describe(error: BaseException) -> str:
    """An error as the summary of a run tells it."""
    return f"{type(error).__name__}: {error}"


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Children inherit the environment at their start: one thread each whatever we have."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _shut_down(pool: ProcessPoolExecutor, *, wait_for_units: bool) -> None:
    """Ends the pool; without waiting, its own processes are ended at once (Ctrl-C, a caller that
    left).
    """
    processes = list((getattr(pool, "_processes", None) or {}).values())
    pool.shutdown(wait=wait_for_units, cancel_futures=True)
    if not wait_for_units:
        for process in processes:
            process.kill()

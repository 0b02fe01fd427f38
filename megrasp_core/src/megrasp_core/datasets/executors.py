"""Runs independent units of work: here, in a pool of processes, or over a Ray cluster (DESIGN
section 5).

Results come back to the calling process, which alone writes files; a worker that dies costs the
unit it held, and that unit is tried again.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from megrasp_core.errors import DataError, InvalidRequestError

U = TypeVar("U")
R = TypeVar("R")
log = logging.getLogger(__name__)

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class ExecutorConfig:
    """How units are spread.

    Attributes:
        kind: "local" for this machine, "ray" for a Ray cluster.
        workers: processes (local; 1 runs in this process) or tasks in flight (ray).
        address: Ray address; None starts Ray on this machine.
        attempts: how often a unit is tried when the process that held it died.
    """

    kind: Literal["local", "ray"] = "local"
    workers: int = 1
    address: str | None = None
    attempts: int = 3


@dataclass(frozen=True)
class Progress:
    """State of a run, given to `on_progress` after every unit."""

    done: int
    failed: int
    total: int
    seconds: float


@dataclass
class RunSummary:
    """What a run did: number of units done, and (unit, message) of those that failed."""

    done: int = 0
    failed: list[tuple[Any, str]] = field(default_factory=list)
    seconds: float = 0.0
    cancelled: bool = False


def run_units(
    function: Callable[[U], R],
    units: Sequence[U],
    config: ExecutorConfig | None = None,
    *,
    on_result: Callable[[U, R], None],
    on_progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Calls `function(unit)` for every unit and hands each result to `on_result` in this process.

    An exception of `function` marks the unit as failed and the run goes on. Ctrl-C stops the run
    between results; what was handed over stays, and the summary says `cancelled`.

    Args:
        function: picklable where more than one process is used.
        units: the work, in the order in which it is started.
        config: how to spread it.
        on_result: called once per finished unit, in order of completion.
        on_progress: called after every unit.

    Raises:
        InvalidRequestError: fewer than one worker, or an unknown kind.
        DataError: Ray was asked for and is not installed.
    """
    config = config or ExecutorConfig()
    if config.workers < 1:
        raise InvalidRequestError(
            f"workers is {config.workers}; expected 1 or more. Give --workers 1 for one process."
        )
    start = time.monotonic()
    summary = RunSummary()
    if config.kind == "local":
        stream = _serial if config.workers == 1 else _pool
    elif config.kind == "ray":
        stream = _ray
    else:
        raise InvalidRequestError(
            f"unknown executor {config.kind!r}; expected local or ray. Choose one with --executor."
        )
    results = stream(function, units, config)
    try:
        for unit, result, message in results:
            if message is None:
                on_result(unit, result)  # type: ignore[arg-type]
                summary.done += 1
            else:
                log.warning("unit %s failed: %s", unit, message)
                summary.failed.append((unit, message))
            summary.seconds = time.monotonic() - start
            if on_progress is not None:
                on_progress(
                    Progress(summary.done, len(summary.failed), len(units), summary.seconds)
                )
    except KeyboardInterrupt:
        log.warning("stopped after %d of %d units", summary.done, len(units))
        summary.cancelled = True
    finally:
        results.close()
    summary.seconds = time.monotonic() - start
    return summary


_Outcome = tuple[U, R | None, str | None]


def _describe(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def _serial(
    function: Callable[[U], R], units: Sequence[U], config: ExecutorConfig
) -> Generator[_Outcome, None, None]:
    del config
    for unit in units:
        try:
            result = function(unit)
        except Exception as error:
            yield unit, None, _describe(error)
        else:
            yield unit, result, None


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Children inherit the environment at their start: one thread each whatever we have."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _pool(
    function: Callable[[U], R], units: Sequence[U], config: ExecutorConfig
) -> Generator[_Outcome, None, None]:
    """Spawned processes. When one is killed the pool breaks: it is built again and what was in
    flight is repeated.
    """
    queue = [(unit, 1) for unit in reversed(units)]
    with _one_thread_each():
        while queue:
            pool = ProcessPoolExecutor(
                config.workers, mp_context=multiprocessing.get_context("spawn")
            )
            flight: dict[Future[R], tuple[U, int]] = {}
            broken = clean = False
            try:
                while (queue or flight) and not broken:
                    while queue and len(flight) < config.workers:
                        unit, attempt = queue.pop()
                        try:
                            flight[pool.submit(function, unit)] = (unit, attempt)
                        except BrokenProcessPool:
                            queue.append((unit, attempt))
                            broken = True
                            break
                    finished, _ = wait(flight, return_when=FIRST_COMPLETED)
                    for future in finished:
                        error = future.exception()
                        if isinstance(error, BrokenProcessPool):
                            broken = True
                            continue
                        unit, _ = flight.pop(future)
                        if error is not None:
                            yield unit, None, _describe(error)
                        else:
                            yield unit, future.result(), None
                # Which of the units in flight killed its process is not known: each is tried
                # again.
                for unit, attempt in flight.values():
                    if attempt < config.attempts:
                        queue.append((unit, attempt + 1))
                    else:
                        yield unit, None, f"its process died {attempt} times"
                clean = True
            finally:
                _shut_down(pool, wait_for_units=clean)


def _shut_down(pool: ProcessPoolExecutor, *, wait_for_units: bool) -> None:
    """Ends the pool; without waiting, its own processes are ended at once (Ctrl-C, a caller that
    left).
    """
    processes = list((getattr(pool, "_processes", None) or {}).values())
    pool.shutdown(wait=wait_for_units, cancel_futures=True)
    if not wait_for_units:
        for process in processes:
            process.terminate()


def _call(function: Callable[[U], R], unit: U) -> R:
    """What Ray runs: it takes plain functions only, and jobs are partial ones."""
    return function(unit)


def _ray(
    function: Callable[[U], R], units: Sequence[U], config: ExecutorConfig
) -> Generator[_Outcome, None, None]:
    try:
        import ray
        from ray.exceptions import WorkerCrashedError
    except ImportError as error:
        raise DataError(
            "the executor 'ray' was given, but the package ray is not installed; expected an "
            "installed ray. "
            "Run `pip install megrasp-core[ray]`, or use --executor local."
        ) from error
    owned = not ray.is_initialized()
    if owned:
        if config.address is None:
            ray.init(num_cpus=config.workers, log_to_driver=False)
        else:
            ray.init(address=config.address, log_to_driver=False)
    try:
        environment = {"env_vars": dict.fromkeys(_THREAD_VARIABLES, "1")}
        remote = ray.remote(num_cpus=1, max_retries=config.attempts - 1, runtime_env=environment)(
            _call
        )
        shared = ray.put(function)
        queue = list(reversed(units))
        flight: dict[Any, U] = {}
        while queue or flight:
            while queue and len(flight) < config.workers:
                unit = queue.pop()
                flight[remote.remote(shared, unit)] = unit
            finished, _ = ray.wait(list(flight), num_returns=1)
            for reference in finished:
                unit = flight.pop(reference)
                try:
                    result = ray.get(reference)
                except WorkerCrashedError:
                    yield unit, None, f"its process died {config.attempts} times"
                except Exception as error:
                    # Ray wraps what the unit raised.
                    yield unit, None, _describe(getattr(error, "cause", None) or error)
                else:
                    yield unit, result, None
    finally:
        if owned:
            ray.shutdown()

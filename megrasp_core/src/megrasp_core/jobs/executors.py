"""Runs independent units of work: here, in a pool of processes, or over a Ray cluster.

Results come back to the calling process, which alone writes files; a worker that dies costs the
unit it held, and that unit is tried again.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from megrasp_core.errors import DataError, InvalidRequestError, MegraspError

from .local_pool import THREAD_VARIABLES, describe, pool_outcomes
from .stopping import StopSignals
from .worker import timed

U = TypeVar("U")
R = TypeVar("R")
log = logging.getLogger(__name__)

UNSAVED = 2
"""So many results in a row that cannot be written end a run: the disk is full, or gone."""


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
    """What a run did.

    Attributes:
        done: number of units whose results were handed over.
        failed: (unit, message) of those that failed or could not be saved.
        seconds: duration.
        cpu_seconds: of the units that were done, in the processes that worked on them.
        cancelled: whether it ended early.
        reason: why it did, "" where it did not.
    """

    done: int = 0
    failed: list[tuple[Any, str]] = field(default_factory=list)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    cancelled: bool = False
    reason: str = ""


def run_units(
    function: Callable[[U], R],
    units: Sequence[U],
    config: ExecutorConfig | None = None,
    *,
    on_result: Callable[[U, R], None],
    on_progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Calls `function(unit)` for every unit and hands each result to `on_result` in this process.

    An exception of `function`, or of `on_result` for a result that cannot be saved, marks the
    unit as failed and the run goes on. It ends early where `UNSAVED` results in a row cannot be
    written, and at Ctrl-C or SIGTERM, between results; what was handed over stays, and the
    summary says `cancelled` and why.

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
    stop, unsaved = StopSignals(), 0
    results = stream(functools.partial(timed, function), units, config, stop)
    try:
        with stop:
            for unit, outcome, message in results:
                with stop.held_back():
                    result, cpu_seconds = outcome or (None, 0.0)
                    if message is None:
                        message, is_written = _saved(on_result, unit, result)
                        unsaved = 0 if is_written else unsaved + 1
                    if message is None:
                        summary.done += 1
                        summary.cpu_seconds += cpu_seconds
                    else:
                        log.warning("unit %s failed: %s", unit, message)
                        summary.failed.append((unit, message))
                    summary.seconds = time.monotonic() - start
                if on_progress is not None:
                    on_progress(
                        Progress(summary.done, len(summary.failed), len(units), summary.seconds)
                    )
                if unsaved >= UNSAVED:
                    summary.cancelled = True
                    summary.reason = (
                        f"{unsaved} results in a row could not be written; make room on the disk, "
                        "or the folder writable"
                    )
                    break
    except KeyboardInterrupt:
        summary.cancelled = True
        summary.reason = stop.received or "Ctrl-C"
    finally:
        results.close()
    if summary.cancelled:
        log.warning("stopped after %d of %d units", summary.done, len(units))
    summary.seconds = time.monotonic() - start
    return summary


def _saved(
    on_result: Callable[[U, R], None], unit: U, result: R | None
) -> tuple[str | None, bool]:
    """Hands a result over; what went wrong, and whether files can be written."""
    try:
        on_result(unit, result)  # type: ignore[arg-type]
    except OSError as error:
        return f"not saved: {error}", False
    except MegraspError as error:
        return f"not saved: {error}", True
    return None, True


_Outcome = tuple[U, R | None, str | None]


def _serial(
    function: Callable[[U], R], units: Sequence[U], _: ExecutorConfig, __: StopSignals
) -> Generator[_Outcome, None, None]:
    for unit in units:
        try:
            result = function(unit)
        except Exception as error:
            yield unit, None, describe(error)
        else:
            yield unit, result, None


def _pool(
    function: Callable[[U], R], units: Sequence[U], config: ExecutorConfig, _: StopSignals
) -> Generator[_Outcome, None, None]:
    return pool_outcomes(function, units, config.workers, config.attempts)


def _call(function: Callable[[U], R], unit: U) -> R:
    """What Ray runs: it takes plain functions only, and jobs are partial ones."""
    return function(unit)


def _ray(
    function: Callable[[U], R], units: Sequence[U], config: ExecutorConfig, stop: StopSignals
) -> Generator[_Outcome, None, None]:
    try:
        import ray
        from ray.exceptions import WorkerCrashedError
    except ImportError as error:
        raise DataError(
            "the executor 'ray' was given, but the package ray is not installed; expected an "
            "installed ray. Run `pip install megrasp-core[ray]`, or use --executor local."
        ) from error
    owned = not ray.is_initialized()
    if owned:
        if config.address is None:
            ray.init(num_cpus=config.workers, log_to_driver=False)
        else:
            ray.init(address=config.address, log_to_driver=False)
        stop.install()
    try:
        environment = {"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")}
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
                    yield unit, None, describe(getattr(error, "cause", None) or error)
                else:
                    yield unit, result, None
    finally:
        if owned:
            ray.shutdown()

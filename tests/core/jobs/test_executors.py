"""Executors: order, failures, killed workers, cancelling, and what a wrong request says."""

from __future__ import annotations

import errno
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

import pytest
from executor_units import (
    die_on_three,
    die_once,
    killer_and_slow,
    late_last,
    square,
    thread_setting,
)

from megrasp_core.errors import DataError, InvalidRequestError, MegraspError
from megrasp_core.jobs import ExecutorConfig, run_units


def run(config: ExecutorConfig, function, units):
    results, steps = {}, []
    summary = run_units(
        function, units, config, on_result=results.__setitem__, on_progress=steps.append
    )
    return results, steps, summary


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.01)


@pytest.mark.parametrize("workers", [1, 2])
def test_results_failures_and_progress(workers):
    results, steps, summary = run(ExecutorConfig(workers=workers), square, range(6))
    assert results == {0: 0, 1: 1, 2: 4, 4: 16, 5: 25}
    assert summary.failed == [(3, "ValueError: three is not wanted")]
    assert summary.done == 5 and not summary.cancelled
    assert [(s.done + s.failed, s.total) for s in steps] == [(n, 6) for n in range(1, 7)]


def test_serial_run_keeps_the_order():
    seen = []
    run_units(square, [5, 1, 4], on_result=lambda unit, _: seen.append(unit))
    assert seen == [5, 1, 4]


def test_a_killed_worker_loses_its_unit_only_for_the_moment(tmp_path):
    results, _, summary = run(
        ExecutorConfig(workers=2), functools.partial(die_once, folder=str(tmp_path)), range(6)
    )
    assert (tmp_path / "died").exists()
    assert results == {n: n for n in range(6)}
    assert not summary.failed


def test_a_unit_that_always_kills_its_worker_does_not_stop_the_rest():
    results, _, summary = run(ExecutorConfig(workers=1 + 1, attempts=4), die_on_three, range(7))
    assert set(results) | {3} == set(range(7))
    assert 3 not in results
    assert "died 4 times" in dict(summary.failed)[3]


def test_a_unit_that_kills_its_worker_takes_no_other_with_it():
    """Two attempts: both would go wrong for the slow unit, were it repeated beside the killer."""
    results, _, summary = run(ExecutorConfig(workers=2, attempts=2), killer_and_slow, range(3))
    assert results == {1: 1, 2: 2}
    assert summary.failed == [(0, "its process died 2 times")]


def test_a_worker_killed_while_it_waits_does_not_hang_the_run(tmp_path):
    """It dies with the lock of the queue, so that the other can only be ended."""
    over, killed, stuck = threading.Event(), [], []

    def kill() -> None:
        until((tmp_path / "2").exists)
        busy = int((tmp_path / "2").read_text())
        idle = {int((tmp_path / name).read_text()) for name in "01"} - {busy}
        killed.extend(idle)
        for pid in idle:
            os.kill(pid, signal.SIGKILL)
        if not over.wait(120):
            stuck.append(busy)
            os.kill(busy, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    unit = functools.partial(late_last, folder=str(tmp_path))
    results, _, summary = run(ExecutorConfig(workers=2), unit, range(3))
    over.set()
    thread.join()
    assert len(killed) == 1 and not stuck
    assert results == {0: 0, 1: 1, 2: 2} and not summary.failed


def unsaved(*errors: Exception | None):
    """What saves nothing but raises one after another of `errors`."""
    left = list(errors)

    def save(unit: int, _: int) -> None:
        error = left.pop(0) if left else None
        if error is not None:
            raise error

    return save


FULL = OSError(errno.ENOSPC, "No space left on device", "scene.npz")


def test_one_result_that_cannot_be_saved_does_not_stop_the_others():
    told = MegraspError("too far away")
    units = [0, 1, 2, 4, 5, 6, 7]
    summary = run_units(square, units, on_result=unsaved(FULL, None, told, told, FULL, None))
    assert [unit for unit, _ in summary.failed] == [0, 2, 4, 5] and summary.done == 3
    assert dict(summary.failed)[2] == "not saved: too far away"
    assert "not saved: [Errno 28] No space left on device: 'scene.npz'" in dict(summary.failed)[0]
    assert not summary.cancelled and not summary.reason


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_ends_when_nothing_can_be_written(workers):
    summary = run_units(
        square,
        [0, 1, 2, 4, 5, 6, 7],
        ExecutorConfig(workers=workers),
        on_result=unsaved(None, FULL, FULL, None),
    )
    assert summary.cancelled and "make room" in summary.reason
    assert summary.done == 1 and len(summary.failed) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_the_result_is_saved(number):
    saved = []
    before = signal.getsignal(number)

    def save(unit: int, _: int) -> None:
        signal.raise_signal(number)
        saved.append(unit)

    summary = run_units(square, [0, 1, 2], on_result=save)
    assert saved == [0] and summary.done == 1 and summary.cancelled
    assert summary.reason == ("Ctrl-C" if number == signal.SIGINT else "SIGTERM")
    assert signal.getsignal(number) == before


def test_a_programs_own_handlers_stay_in_charge():
    told = []
    before = signal.signal(signal.SIGTERM, lambda *_: told.append("asked to end"))
    try:
        summary = run_units(
            square, [0, 1], on_result=lambda *_: signal.raise_signal(signal.SIGTERM)
        )
    finally:
        signal.signal(signal.SIGTERM, before)
    assert told == ["asked to end"] * 2 and summary.done == 2 and not summary.cancelled


def test_workers_get_one_thread_and_the_callers_environment_stays(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    results, _, _ = run(ExecutorConfig(workers=2), thread_setting, range(2))
    assert results == {0: ("1", True), 1: ("1", True)}
    assert os.environ["OMP_NUM_THREADS"] == "7"


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_what_is_done(workers):
    kept = []

    def stop_after_two(unit: int, _: int) -> None:
        kept.append(unit)
        if len(kept) == 2:
            raise KeyboardInterrupt

    summary = run_units(
        square, [0, 1, 2, 4, 5], ExecutorConfig(workers=workers), on_result=stop_after_two
    )
    assert summary.cancelled
    assert len(kept) == 2 and summary.done == 1


def test_ray_does_the_same_as_the_local_pool(ray_cluster):
    found = [run(ExecutorConfig(kind, workers=2), square, range(6)) for kind in ("local", "ray")]
    assert found[0][0] == found[1][0]
    assert found[0][2].failed == found[1][2].failed
    assert found[1][2].done == 5


def test_ray_repeats_a_unit_whose_process_died(ray_cluster, tmp_path):
    once = functools.partial(die_once, folder=str(tmp_path))
    results, _, summary = run(ExecutorConfig("ray", workers=2), once, range(6))
    assert (tmp_path / "died").exists()
    assert results == {n: n for n in range(6)} and not summary.failed
    results, _, summary = run(ExecutorConfig("ray", workers=2, attempts=2), die_on_three, range(5))
    assert results == {0: 0, 1: 1, 2: 2, 4: 4}
    assert "died 2 times" in dict(summary.failed)[3]


def test_wrong_requests_say_what_is_expected(monkeypatch):
    with pytest.raises(InvalidRequestError, match=r"workers is 0; expected 1 or more"):
        run(ExecutorConfig(workers=0), square, [1])
    with pytest.raises(
        InvalidRequestError, match=r"unknown executor 'slurm'; expected local or ray"
    ):
        run(ExecutorConfig(kind="slurm"), square, [1])  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DataError, match=r"pip install megrasp-core\[ray\].*--executor local"):
        run(ExecutorConfig(kind="ray"), square, [1])

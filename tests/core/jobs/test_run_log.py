"""What runs leave beside the data."""

from __future__ import annotations

import time

import pytest
from made_library import made_library

from megrasp_core.cli.data.pack import pack
from megrasp_core.jobs import ExecutorConfig, RunSummary, add_runs, log_run, run_units, runs_of
from megrasp_core.jobs.run_log import NAME
from megrasp_core.library import write_grasp_set


def busy(seconds: float) -> float:
    """Use the processor for so many seconds."""
    start = time.process_time()
    while time.process_time() - start < seconds:
        pass
    return seconds


@pytest.mark.slow
def test_the_units_seconds_are_counted_where_they_are_worked_on():
    for workers in (1, 2):
        summary = run_units(
            busy, [0.1, 0.2], ExecutorConfig(workers=workers), on_result=lambda *_: None
        )
        assert 0.3 <= summary.cpu_seconds < 1.0


def test_runs_add_up_and_a_line_cut_short_is_left_out(tmp_path):
    assert runs_of(tmp_path) == []
    log_run(tmp_path, None, RunSummary())
    assert not (tmp_path / NAME).exists(), "a run that did nothing is none"
    log_run(tmp_path, None, RunSummary(done=3, cpu_seconds=6.04), {"seed": 7})
    with (tmp_path / NAME).open("a") as file:
        file.write('{"done": 1, "cpu_sec\n')
    log_run(tmp_path, ExecutorConfig("local", 2), RunSummary(done=1, failed=[(0, "no")]))
    first, second = runs_of(tmp_path)
    assert (first["done"], first["cpu_seconds"], first["seed"]) == (3, 6.0, 7)
    assert (second["workers"], second["failed"]) == (2, 1)
    assert first["versions"]["mujoco"] and first["cpu"]
    add_runs(tmp_path, [first, {"done": 9}])
    assert [run["done"] for run in runs_of(tmp_path)] == [3, 1, 9]


def test_a_packed_library_takes_its_runs_along(tmp_path):
    for entry in made_library():
        write_grasp_set(tmp_path / "loose", entry)
    log_run(tmp_path / "loose", None, RunSummary(done=1), {"seed": 0})
    for _ in range(2):
        assert pack((tmp_path / "loose",), tmp_path / "packed") == 0
    assert runs_of(tmp_path / "packed") == runs_of(tmp_path / "loose") != []

"""What starts and requests cost is told beside what they are compared with."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from megrasp_core.benchmarks import serving, startup
from megrasp_core.benchmarks.synthesis import BenchCase
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.synthesizer import GraspSynthesizer

ROOT = Path(__file__).parents[3]


def test_a_start_is_timed_in_both_checkouts(monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import megrasp_core, sys; sys.exit(0)"
    monkeypatch.setattr(startup, "PROGRAMS", {"nothing": program})
    content = startup.bench_startup(ROOT, repeats=1)
    (row,) = content["cpu_seconds"]
    assert row["before"] > 0 and row["now"] > 0
    assert row["ratio"] == pytest.approx(row["now"] / row["before"], rel=0.2)
    assert "| `nothing` |" in startup.startup_table(content)


def test_a_start_that_fails_is_no_figure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequestError, match="worktree"):
        startup.bench_startup(tmp_path)
    monkeypatch.setattr(startup, "PROGRAMS", {"broken": "raise SystemExit(3)"})
    with pytest.raises(DataError, match="failed"):
        startup.bench_startup(ROOT, repeats=1)


@pytest.mark.slow
def test_a_request_is_timed_beside_the_call() -> None:
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="random").eval()
    synthesizer = GraspSynthesizer(model, "franka_hand", threads=1)
    content = serving.bench_serving(synthesizer, cases=[BenchCase("fast", 2, 2)], repeats=1)
    (row,) = content["rows"]
    for which in ("request", "in_process"):
        assert row[which]["cpu_seconds"]["median"] > 0
    beyond = row["request"]["seconds"]["median"] - row["in_process"]["seconds"]["median"]
    assert row["beyond"]["seconds"]["median"] == pytest.approx(beyond, abs=2e-4)
    assert content["transport"]["seconds"]["median"] > content["status"]["seconds"]["min"]

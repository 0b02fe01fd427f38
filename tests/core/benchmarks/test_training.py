"""The benchmark of training runs, and says what it lacks."""

from __future__ import annotations

from pathlib import Path

import pytest
from training_scenes import record, written

from megrasp_core.benchmarks import training as bench
from megrasp_core.cli import main
from megrasp_core.errors import DataError, InvalidRequestError

ROOT = Path(__file__).resolve().parents[3]
RACK = ("robotiq_2f85", "franka_hand", "robotiq_3f", "allegro_hand")


@pytest.mark.slow
def test_a_contestant_is_timed_in_a_process_of_its_own(tmp_path):
    data = written(tmp_path / "data", (record(seed, grippers=RACK) for seed in range(7)))
    scenes = bench._rich_scenes(data)
    assert len(scenes) == 6
    here = bench.Contestant("torch", ROOT / "megrasp_core" / "src", bench._NOW)
    assert bench._timed(here, data, scenes, steps=1) > 1.0


def test_errors_say_what_is_missing(tmp_path, capsys):
    data = written(tmp_path / "data", (record(seed, grippers=RACK[:2]) for seed in range(7)))
    with pytest.raises(DataError, match="has 0 scenes with labels of exactly 4 grippers"):
        bench._rich_scenes(data)
    with pytest.raises(InvalidRequestError, match="git worktree add DIR COMMIT"):
        bench.bench_training(data, tmp_path)
    assert main(["bench", "--stage", "training", "--data", str(data)]) == 2
    assert "expected both with --stage training" in capsys.readouterr().err

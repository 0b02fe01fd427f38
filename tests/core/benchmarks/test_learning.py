"""The benchmark of learning trains both, keeps what is finished and says what it lacks."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from training_scenes import record, written

from megrasp_core.benchmarks.learning import GRIPPERS, bench_learning
from megrasp_core.cli import main
from megrasp_core.errors import DataError, InvalidRequestError

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_both_train_side_by_side_and_are_validated_alike(tmp_path: Path) -> None:
    data = written(tmp_path / "data", (record(seed, grippers=GRIPPERS) for seed in range(4)))
    other = written(tmp_path / "other", (record(seed, grippers=GRIPPERS) for seed in (90, 91)))

    def run() -> dict:
        return bench_learning(data, other, ROOT, tmp_path / "work", cpu_seconds=1e-3, share=0.5)

    first = run()
    before, now = first["learners"]["before"], first["learners"]["now"]
    assert before["pairs"] == now["pairs"] > 0
    assert set(now["per_gripper"]) == set(GRIPPERS)
    # One step each, of the same network, from the same seed.
    assert math.isclose(before["diffusion"], now["diffusion"], abs_tol=0.02)
    done = [tmp_path / "work" / name / "done.json" for name in ("before", "now")]
    made = [file.stat().st_mtime_ns for file in done]
    assert run() == first
    assert [file.stat().st_mtime_ns for file in done] == made
    # With other code, or other time, what is there counts no more.
    left = json.loads(done[1].read_text())
    done[1].write_text(json.dumps({**left, "given": {**left["given"], "code": "of yesterday"}}))
    made[1] = done[1].stat().st_mtime_ns
    run()
    again = done[1].stat().st_mtime_ns
    bench_learning(data, other, ROOT, tmp_path / "work", cpu_seconds=1e-3, share=0.25)
    assert made[1] < again < done[1].stat().st_mtime_ns
    assert done[0].stat().st_mtime_ns == made[0]


def test_errors_say_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidRequestError, match="git worktree add DIR COMMIT"):
        bench_learning(tmp_path, tmp_path, tmp_path, tmp_path / "work")
    with pytest.raises(DataError, match=r"the trainer before in .* failed.*log.txt"):
        bench_learning(tmp_path / "none", tmp_path, ROOT, tmp_path / "work", cpu_seconds=1e-3)
    assert main(["bench", "--stage", "learning", "--data", str(tmp_path)]) == 2
    assert "expected all of them" in capsys.readouterr().err

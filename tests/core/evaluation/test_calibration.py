"""The fit of the score where folds hold one outcome alone, and what is kept of judged grasps."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from megrasp_core.cli import main
from megrasp_core.errors import DataError
from megrasp_core.evaluation.calibration import (
    JudgedGrasps,
    calibrate,
    calibrate_kinds,
    read_judged,
    write_judged,
)
from megrasp_core.network import PRESETS, GraspModel, save_model


def judged(scene: np.ndarray, success: np.ndarray) -> JudgedGrasps:
    rng = np.random.default_rng(0)
    confidence = np.where(success, 0.8, 0.4) + rng.uniform(-0.2, 0.2, len(success))
    features = np.zeros((len(success), 4))
    features[:, 0] = np.log(confidence) - np.log1p(-confidence)
    return JudgedGrasps("franka_hand", "parallel", scene, features, confidence, success, (3, 4))


def test_a_fold_whose_remainder_only_holds_is_left_out() -> None:
    scene = np.repeat(np.arange(5), 40)
    success = np.ones(200, bool)
    success[3:20] = False  # all failures in the first scene
    part = judged(scene, success)
    fitted, report = calibrate([part])
    assert fitted.confidence > 0
    assert report["held_out"]["judged"] == 160
    assert sum(row["count"] for row in report["reliability"]) == 160
    assert calibrate_kinds([part])[0] == {"parallel": fitted}
    # With one scene nothing can be left out.
    alone = dataclasses.replace(part, scene=np.zeros(200, np.int64))
    assert calibrate([alone])[1]["held_out"] == {"log_loss": None, "auc": None, "judged": 0}


def test_judged_grasps_are_kept_and_fitted_again(tmp_path: Path, capsys) -> None:
    rng = np.random.default_rng(1)
    part = judged(np.arange(60) % 6, rng.random(60) < 0.5)
    hand = dataclasses.replace(part, gripper="allegro_hand", kind="hand", first=(1, 2))
    file = tmp_path / "of" / "run.judged.npz"
    write_judged([part, hand], file)
    back = read_judged(file)
    for one, other in zip(back, [part, hand], strict=True):
        for name, value in dataclasses.asdict(other).items():
            np.testing.assert_array_equal(getattr(one, name), value)
    torch.manual_seed(0)
    model = save_model(GraspModel(PRESETS["tiny"], model_id="fresh"), tmp_path / "fresh")
    out = tmp_path / "calibration.json"
    arguments = ["calibrate", "--model", str(model), "--out", str(out), "--rows", str(file)]
    assert main(arguments) == 0
    report = json.loads(out.read_text())
    assert report["rows"] == ["run.judged.npz"]
    assert report["grippers"]["allegro_hand"]["judged"] == 60
    assert main([*arguments, str(file)]) == 0
    assert json.loads(out.read_text())["grippers"]["allegro_hand"] == {
        name: 2 * count for name, count in hand.counts().items()
    }
    assert main([*arguments, "--gripper", "franka_hand"]) == 2
    assert "expected it alone" in capsys.readouterr().err
    file.write_bytes(b"half of it")
    with pytest.raises(DataError, match="judged grasps that"):
        read_judged(file)


def test_rows_are_written_before_they_are_fitted(tmp_path: Path, monkeypatch, capsys) -> None:
    part = judged(np.arange(60) % 6, np.ones(60, bool))
    monkeypatch.setattr("megrasp_core.cli.calibrate._simulated", lambda *_: ([part], []))
    torch.manual_seed(0)
    model = save_model(GraspModel(PRESETS["tiny"], model_id="fresh"), tmp_path / "fresh")
    out = tmp_path / "calibration.json"
    assert main(["calibrate", "--model", str(model), "--out", str(out)]) == 2
    assert "60 successes of 60 grasps" in capsys.readouterr().err
    assert read_judged(tmp_path / "calibration.judged.npz")[0].counts() == part.counts()

"""A score that is calibrated, and a confidence that learns, from what a real cell recorded."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from made_attempts import NAME, made_attempt

from megrasp_core.cli.app import main
from megrasp_core.diffusion import SamplerSettings
from megrasp_core.errors import InvalidRequestError
from megrasp_core.evaluation.attempts import judged_attempts, recalibrated, require_enough
from megrasp_core.evaluation.calibration import JudgedGrasps, calibrate
from megrasp_core.grippers import load_gripper
from megrasp_core.network import PRESETS, GraspModel, ModelInfo, load_model, save_model
from megrasp_core.ranking import Calibration
from megrasp_core.self_labelling.attempts import attempt_scene, write_attempt_scenes
from megrasp_core.storage import AttemptFolder, SceneDataset

COUNT = 44
STEEP = 0.3
"""In this cell a grasp tilted by more than this (rad) fails."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell in which tilted grasps fail, whatever the model promised; one file is damaged."""
    folder = AttemptFolder(tmp_path_factory.mktemp("attempts"))
    gripper, rng = load_gripper(NAME), np.random.default_rng(0)
    for time in range(1, COUNT + 1):
        tilt = float(rng.uniform(0.0, 0.6))
        won = tilt < STEEP
        folder.add(
            made_attempt(
                time, gripper=gripper, tilt=tilt, success=won, reason="" if won else "slipped"
            )
        )
    (folder.folder / "attempt_00000000000000000099.npz").write_bytes(b"half of it")
    return folder.folder


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small model that was never trained."""
    torch.manual_seed(0)
    fresh = GraspModel(PRESETS["tiny"], model_id="fresh")
    fresh.info = dataclasses.replace(
        fresh.info, heads=("confidence",), sampler=SamplerSettings(steps=7)
    )
    return save_model(fresh, tmp_path_factory.mktemp("models") / "fresh")


def test_the_score_learns_what_fails_in_this_cell(recorded: Path, model: Path, tmp_path) -> None:
    out = tmp_path / "calibration.json"
    arguments = ["calibrate", "--attempts", str(recorded), "--model", str(model)]
    assert main([*arguments, "--out", str(out), "--write"]) == 0
    report = json.loads(out.read_text())
    assert report["grippers"][NAME]["judged"] == COUNT
    assert report["grippers"][NAME]["successes"] == report["grippers"][NAME]["first_successes"]
    assert report["calibration"]["tilt"] < -1.0, "steep grasps are worse here"
    # What is held out is foretold as well, and what was promised so far was not.
    assert report["held_out"]["auc"] > 0.9
    assert report["held_out"]["log_loss"] < report["recorded"]["log_loss"]
    assert report["held_out"]["log_loss"] < report["before"]["log_loss"]
    assert len(report["notes"]) == 1 and "99.npz" in report["notes"][0]
    # A gripper that the model was not trained with takes the calibration for all.
    kept = load_model(model).info.calibration_for(NAME, "parallel")
    assert kept is not None and kept.tilt == pytest.approx(report["calibration"]["tilt"], abs=1e-3)


def test_only_what_was_tried_is_calibrated_anew(model: Path) -> None:
    info = dataclasses.replace(
        load_model(model).info,
        trained_grippers={NAME: "hash", "allegro_hand": "hash"},
        calibration=Calibration(bias=1.0),
        calibration_by_kind={"hand": Calibration(bias=2.0)},
    )
    kind = load_gripper(NAME).description.kind
    part = JudgedGrasps(
        NAME, kind, np.zeros(1), np.zeros((1, 4)), np.zeros(1), np.ones(1, bool), (1, 1)
    )
    found = recalibrated(info, [part], Calibration(bias=3.0), {})
    stranger = dataclasses.replace(part, gripper="own_gripper")
    other = recalibrated(info, [stranger], Calibration(bias=3.0), {kind: Calibration(bias=4.0)})

    def bias(of: ModelInfo, name: str, kind: str) -> float:
        calibration = of.calibration_for(name, kind)
        assert calibration is not None
        return calibration.bias

    assert bias(found, NAME, kind) == 3.0
    assert bias(found, "allegro_hand", "hand") == 2.0
    assert bias(found, "own_gripper", kind) == 1.0
    assert bias(other, "own_gripper", kind) == 3.0
    assert bias(other, NAME, kind) == 4.0


def test_attempts_with_another_gripper_or_description_are_left_out(model: Path) -> None:
    notes: list[str] = []
    gone = dataclasses.replace(made_attempt(3), gripper="gone")
    few = [made_attempt(1), made_attempt(2, gripper_hash="other"), gone]
    with pytest.raises(InvalidRequestError, match="1 usable attempts were given, 1 successes"):
        judged_attempts(few, load_model(model), notes)
    assert len(notes) == 2
    assert "another description of robotiq_2f85" in notes[0] and "'gone'" in notes[1]


def test_a_model_without_confidence_is_told(model: Path) -> None:
    blind = load_model(model)
    blind.info = dataclasses.replace(blind.info, heads=())
    notes: list[str] = []
    with pytest.raises(InvalidRequestError, match="0 usable attempts"):
        judged_attempts([made_attempt(1)], blind, notes)
    assert "no confidence" in notes[0]


@pytest.mark.parametrize(("won", "lost"), [(20, 19), (39, 9), (9, 39), (0, 0)])
def test_too_few_say_nothing(won: int, lost: int) -> None:
    with pytest.raises(InvalidRequestError, match=f"{won} successes and {lost} failures"):
        require_enough(np.repeat([True, False], [won, lost]), "a calibration")
    require_enough(np.repeat([True, False], [30, 10]), "a calibration")


def test_too_few_end_the_command(model: Path, tmp_path: Path, capsys) -> None:
    folder = AttemptFolder(tmp_path / "attempts")
    for time in (1, 2):
        folder.add(made_attempt(time))
    out = tmp_path / "calibration.json"
    arguments = ["--attempts", str(folder.folder), "--model", str(model), "--out", str(out)]
    assert main(["calibrate", *arguments]) == 2
    assert "expected at least 40 with 10 of each" in capsys.readouterr().err
    assert not out.exists()
    assert main(["calibrate", "--attempts", str(tmp_path / "gone"), "--out", str(out)]) == 2
    assert "holds no attempt_*.npz" in capsys.readouterr().err


def test_parts_are_calibrated_as_those_of_the_simulation(recorded: Path, model: Path) -> None:
    """One form for both, so that one function fits them."""
    some = list(AttemptFolder(recorded).read_all([]))
    parts, _ = judged_attempts(some, load_model(model), [])
    assert [part.gripper for part in parts] == [NAME]
    assert parts[0].features.shape == (COUNT, 4)
    fitted, _ = calibrate(parts)
    foretold = fitted.of_features(parts[0].features)
    assert foretold[parts[0].success].mean() > foretold[~parts[0].success].mean() + 0.4


def test_an_attempt_is_a_scene_with_one_label_wherever_its_frame_lies() -> None:
    """In base coordinates of a robot hall, 50 m off, nothing of the shape is lost."""
    near, far = made_attempt(3), made_attempt(3, success=False, reason="slipped")
    offset = np.array([50.0, -20.0, 1.0])
    moved = {name: getattr(far, name).copy() for name in ("world_from_tcp", "approach")}
    for pose in moved.values():
        pose[:3, 3] += offset
    assert far.sensor is not None and far.region is not None
    far = dataclasses.replace(
        far, points=far.points + offset, sensor=far.sensor + offset,
        region=dataclasses.replace(far.region, world_from_box=_shifted(offset, [0, 0, 0.1])),
        **moved,
    )  # fmt: skip
    here, there = attempt_scene(near), attempt_scene(far)
    assert here.labels[NAME].label.tolist() == [1] and there.labels[NAME].label.tolist() == [0]
    assert there.labels[NAME].reason.tolist() == ["slipped"]
    # Voxel means depend on the grid, so only the shape is compared.
    for scene in (here, there):
        points = scene.points.astype(np.float64)
        assert np.abs(points).max() < 0.5
        tcp = scene.labels[NAME].world_from_tcp[0, :3]
        assert np.linalg.norm(points - tcp, axis=1).min() < 0.03
        assert np.ptp(points[:, 2]) == pytest.approx(0.05, abs=0.004)


def _shifted(offset: np.ndarray, place: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = offset + place
    return pose


def test_new_attempts_are_added_to_the_scenes_of_the_old_ones(tmp_path: Path) -> None:
    notes: list[str] = []
    first = [made_attempt(1), made_attempt(2, success=False), made_attempt(3, gripper_hash="x")]
    success, grippers = write_attempt_scenes(first, tmp_path, notes)
    assert success.tolist() == [True, False] and grippers == [NAME] and len(notes) == 1
    again, _ = write_attempt_scenes([*first, made_attempt(4)], tmp_path, [])
    assert again.tolist() == [True, False, True]
    names = SceneDataset(tmp_path).names
    assert names == [f"scene_{time:010d}" for time in (1, 2, 4)]


@pytest.mark.slow
def test_the_confidence_learns_from_attempts(recorded: Path, model: Path, tmp_path) -> None:
    """It tells tilted grasps from upright ones afterwards; the diffusion stays as it was."""
    out = tmp_path / "heads"
    code = main(
        ["train", "--heads-of", str(model), "--attempts", str(recorded), "--out", str(out),
         "--total-poses", "640", "--set", "scenes_per_step=8", "warmup_steps=5",
         "learning_rate=0.003", "ema_decay=0.9", "node_sets=1", "gravity_dropout=0.0"]
    )  # fmt: skip
    assert code == 0
    before, after = load_model(model), load_model(out / "model")
    assert after.info.sampler == before.info.sampler
    same = before.state_dict()
    assert all(
        torch.equal(value, same[name])
        for name, value in after.state_dict().items()
        if name.startswith("residual_head")
    )
    kept = list(AttemptFolder(recorded).read_all([]))
    parts, _ = judged_attempts(kept, after, [])
    (part,) = parts
    won, lost = part.confidence[part.success], part.confidence[~part.success]
    assert won.mean() > lost.mean() + 0.05


def test_attempts_train_heads_alone(recorded: Path, model: Path, tmp_path, capsys) -> None:
    out = ["--out", str(tmp_path / "run")]
    assert main(["train", "--attempts", str(recorded), *out]) == 2
    assert "--attempts was given without --heads-of" in capsys.readouterr().err
    assert main(["train", *out]) == 2
    assert "no --data was given" in capsys.readouterr().err

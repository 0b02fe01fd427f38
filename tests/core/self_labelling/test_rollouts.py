"""Bins cleared by a network of random weights: the records and the labels, not the success."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch

from megrasp_core.errors import DataError, SimulationError
from megrasp_core.evaluation.calibration import calibrate, calibrate_kinds, judged_grasps
from megrasp_core.evaluation.planners import AntipodalPlanner
from megrasp_core.evaluation.protocols import ProtocolSettings
from megrasp_core.grippers import load_gripper
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.objects import ObjectSet, procedural_names, procedural_object
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.scenes import SceneConfig
from megrasp_core.self_labelling.rollouts import (
    ON_TABLES,
    STAGES,
    RolloutSettings,
    label_rollouts,
)
from megrasp_core.storage import Kind, SceneDataset
from megrasp_core.synthesizer import GraspSynthesizer
from megrasp_core.training import SceneSource, TrainConfig, read_entries

OBJECTS = ObjectSet(procedural_names(6))
SETTINGS = RolloutSettings(
    judged=2,
    rejected=2,
    max_stages=2,
    drawn=8,
    scenes=SceneConfig(grippers=(), objects=(2, 3), bin_share=1.0, obstacle_share=1.0),
)


@pytest.fixture(scope="module")
def synthesizer():
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="random").eval().requires_grad_(False)
    return GraspSynthesizer(model, "robotiq_2f85")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, synthesizer):
    out = tmp_path_factory.mktemp("rollouts")
    assert label_rollouts(out, synthesizer, OBJECTS, range(3, 5), SETTINGS).stages >= 2
    return out


def test_every_stage_is_a_scene_with_the_grasps_that_were_tried(folder):
    dataset = SceneDataset(folder)
    assert {record.seed // STAGES for record in dataset} == {3, 4}
    for record in dataset:
        labels = record.labels["robotiq_2f85"]
        assert 0 < len(labels) <= 4
        assert (labels.kind == int(Kind.SAMPLED)).all()
        assert ((labels.reason == "") == (labels.label == 1)).all()
        assert (labels.object >= 0).all() and (labels.object < len(record.object_names)).all()
        assert record.obstacle.any() and len(record.obstacle) == len(record.object_poses)
        assert record.bin is not None and len(record.points) > 500


def test_tables(tmp_path, synthesizer):
    config = dataclasses.replace(ON_TABLES, objects=(1, 2))
    settings = dataclasses.replace(SETTINGS, max_stages=1, scenes=config)
    assert label_rollouts(tmp_path, synthesizer, OBJECTS, [5], settings).stages == 1
    record = SceneDataset(tmp_path)[0]
    assert record.bin is None and not record.obstacle.any()
    assert len(record.labels["robotiq_2f85"])


def test_a_finished_bin_is_not_made_again(folder, synthesizer):
    done = label_rollouts(folder, synthesizer, OBJECTS, range(3, 5), SETTINGS)
    assert (done.stages, done.failed) == (0, 0)


def test_a_run_for_another_gripper_wants_a_folder_of_its_own(folder, synthesizer):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["grippers"] == {"robotiq_2f85": synthesizer.gripper.hash}
    other = GraspSynthesizer(synthesizer.model, "franka_hand")
    with pytest.raises(DataError, match="differs in grippers"):
        label_rollouts(folder, other, OBJECTS, range(3, 5), SETTINGS)


def test_folders_without_the_grippers_in_their_manifest_are_read(folder, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(folder, old)
    manifest = json.loads((old / "manifest.json").read_text())
    for name in ("grippers", "objects", "versions"):
        del manifest[name]
    (old / "manifest.json").write_text(json.dumps(manifest))
    assert len(read_entries([old])) == len(SceneDataset(folder))


def test_scenes_that_fail_are_counted_and_told(tmp_path, synthesizer, monkeypatch, caplog):
    def unsettled(seed, *_):
        raise SimulationError(f"the heap of seed {seed} does not come to rest.")

    monkeypatch.setattr("megrasp_core.self_labelling.rollouts.roll_out", unsettled)
    done = label_rollouts(tmp_path, synthesizer, OBJECTS, range(2), SETTINGS)
    assert (done.stages, done.failed) == (0, 2)
    assert "scene 1 was left out: the heap of seed 1" in caplog.text


def test_the_heads_train_on_stages_without_a_success(folder):
    config = TrainConfig(
        network=PRESETS["tiny"], train_only="heads", grippers=("robotiq_2f85",),
        confidence_poses=10_000,
    )  # fmt: skip
    entry = next(iter(read_entries([folder]).values()))
    table = entry.tables["robotiq_2f85"]
    nothing = np.zeros(len(table), bool)
    entry.tables["robotiq_2f85"] = dataclasses.replace(
        table, good=nothing, target=nothing.astype(np.float32)
    )
    source = SceneSource([entry], config, SceneSettings())
    batch = source.draw(np.random.default_rng(0))
    assert not batch.positives and len(batch.labelled["robotiq_2f85"]) == len(table)


ARRAYS = ("scene", "features", "confidence", "success")


@pytest.mark.slow
def test_calibration_from_judged_grasps():
    gripper = load_gripper("robotiq_2f85")
    pool = [procedural_object(seed, kind="box") for seed in range(6)]
    settings = ProtocolSettings(scenes=2, graspable=3, obstacles=0, judged=4, drawn=300)
    judged = judged_grasps(settings, gripper, AntipodalPlanner(gripper), pool, range(6))
    assert len(judged.success) == len(judged.features) > 0
    # The baseline has no confidence: one is put in that tells the verdict with some noise.
    rng = np.random.default_rng(0)
    repeats = 40
    success = rng.random(len(judged.success) * repeats) < 0.5
    features = np.repeat(judged.features, repeats, axis=0)
    features[:, 0] = np.where(success, 1.0, -1.0) + rng.normal(size=len(success))
    told = dataclasses.replace(
        judged,
        scene=np.arange(len(success)) % 10,
        features=features,
        confidence=1 / (1 + np.exp(-features[:, 0])),
        success=success,
    )
    calibration, report = calibrate([told])
    assert calibration.confidence == pytest.approx(2.0, abs=0.4)
    assert report["held_out"]["log_loss"] < report["confidence"]["log_loss"]
    assert report["grippers"]["robotiq_2f85"]["judged"] == len(success)
    assert sum(row["count"] for row in report["reliability"]) == len(success)
    few = dataclasses.replace(
        told, kind="hand", **{name: getattr(told, name)[:20] for name in ARRAYS}
    )
    fitted, reports = calibrate_kinds([told, few])
    assert fitted == {told.kind: calibration} and reports[told.kind] == report

"""A tiny run from data on disk to a model that loads, stopped and resumed."""

from __future__ import annotations

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from megrasp_core.datasets import GripperLabels, SceneDataset, SceneRecord, SceneWriter
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.network import PRESETS, load_model
from megrasp_core.training import SceneSource, TrainConfig, balance, record_nodes, train

GRIPPER = "robotiq_2f85"
CONFIG = TrainConfig(
    preset="tiny",
    model_id="tiny-run",
    grippers=(GRIPPER,),
    poses_per_gripper=32,
    confidence_poses=8,
    warmup_steps=2,
    total_poses=32 * 6,
    total_seconds=None,
    validation_scenes=1,
)


def record(seed: int) -> SceneRecord:
    """Points on a 10 cm cube face with grasps of two owners, one of them rare."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.05, 0.05, (400, 3))
    points[:, 2] = 0.05
    count = 30
    poses = np.concatenate(
        [
            rng.uniform(-0.05, 0.05, (count, 3)),
            Rotation.random(count, random_state=seed).as_quat(),
        ],
        1,
    )
    labels = GripperLabels(
        poses.astype(np.float32),
        (np.arange(count) < 2).astype(np.int16),
        (np.arange(count) < 20).astype(np.int8),
        np.zeros(count, np.int8),
        np.full(count, "", np.str_),
        np.zeros(count, np.int8),
    )
    return SceneRecord(
        name=f"scene_{seed:010d}",
        seed=seed,
        object_names=("a", "b"),
        object_poses=np.zeros((2, 7), np.float32),
        obstacle=np.zeros(2, bool),
        bin=None,
        points=points.astype(np.float16),
        normals=np.tile([0, 0, 127], (400, 1)).astype(np.int8),
        on_plane=np.zeros(400, bool),
        sensor=np.array([0, 0, 0.8], np.float32),
        gravity=np.array([0, 0, -1], np.float32),
        labels={GRIPPER: labels},
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    writer = SceneWriter(folder, {"config": "test"})
    for seed in range(10):
        writer.add(record(seed))
    writer.close()
    return folder


def test_run_resume_and_load(data, tmp_path):
    seen = []
    half = dataclasses.replace(CONFIG, total_poses=32 * 3)
    train(data, tmp_path, half, on_progress=lambda counters, losses: seen.append(losses))
    assert len(seen) == 3
    assert {"diffusion", "score", "confidence", "graspability"} <= set(seen[0])
    first = load_model(tmp_path / "model")
    train(data, tmp_path, CONFIG, resume=True)
    second = load_model(tmp_path / "model")
    counters = second.info["counters"]
    assert counters["poses"] == 32 * 6
    assert counters["scenes"] == counters["steps"] == 6
    assert not torch.equal(first.residual_head[0].weight, second.residual_head[0].weight), (
        "a resumed run must go on training"
    )
    assert list(second.info["trained_grippers"]) == [GRIPPER]
    lines = [json.loads(line) for line in (tmp_path / "losses.jsonl").read_text().splitlines()]
    assert [line["steps"] for line in lines] == [3, 6]
    assert all(np.isfinite(line["validation_diffusion"]) for line in lines)
    assert (tmp_path / "losses.png").stat().st_size > 1000


def test_resume_goes_on_as_if_never_stopped(data, tmp_path):
    """Up to the rounding of the stored optimiser moments."""
    train(
        data, tmp_path / "whole", dataclasses.replace(CONFIG, total_poses=32 * 4, decay_share=1e-6)
    )
    part = dataclasses.replace(CONFIG, total_poses=32 * 2, decay_share=1e-6)
    train(data, tmp_path / "half", part)
    shutil.copytree(tmp_path / "half", tmp_path / "split")
    train(data, tmp_path / "split", dataclasses.replace(part, total_poses=32 * 4), resume=True)
    whole, split = (
        load_model(tmp_path / name / "model").state_dict() for name in ("whole", "split")
    )
    half_way = load_model(tmp_path / "half" / "model").state_dict()

    def distance(other: dict[str, torch.Tensor]) -> float:
        return float(sum((whole[k] - other[k]).abs().sum() for k in whole))

    assert distance(split) < 0.02 * distance(half_way)


def test_training_learns_a_fixed_grasp(tmp_path):
    """One top-down grasp in every scene: well below the loss of predicting zero (about 1)."""
    writer = SceneWriter(tmp_path / "data", {"config": "one grasp"})
    for seed in range(4):
        scene = record(seed)
        labels = scene.labels[GRIPPER]
        labels.world_from_tcp[:] = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]
        writer.add(scene)
    losses = []
    config = dataclasses.replace(CONFIG, total_poses=32 * 100, learning_rate=3e-3)
    train(
        tmp_path / "data", tmp_path / "run", config,
        on_progress=lambda counters, values: losses.append(values["diffusion"]),
    )  # fmt: skip
    assert np.mean(losses[:5]) > 0.9
    assert np.mean(losses[-10:]) < 0.8


def test_heads_only_leaves_the_diffusion(data, tmp_path):
    base = train(data, tmp_path / "base", dataclasses.replace(CONFIG, total_poses=32))
    config = dataclasses.replace(
        CONFIG, train_only="heads", total_poses=None, total_seconds=0.5, confidence_weight=1.0
    )
    after = train(data, tmp_path / "heads", config, start_from=base)
    before = base.state_dict()
    for name, value in after.state_dict().items():
        same = torch.equal(value, before[name])
        if name.startswith("confidence_head"):
            assert not same, f"{name} must have been trained"
        if not name.startswith(("confidence", "graspability")):
            assert same, f"{name} must not change"


def test_balanced_batches_give_rare_objects_their_share():
    owner = np.array([0] * 90 + [1] * 10)
    weights = balance(owner)
    assert np.isclose(weights[owner == 1].sum(), 0.5)
    assert np.isclose(weights.sum(), 1.0)


def test_batch_is_centred_like_its_nodes(data):
    dataset = SceneDataset(data)
    source = SceneSource(dataset, CONFIG, PRESETS["tiny"], [0])
    batch = source.batch(source.record(0), np.random.default_rng(0), augment=False)
    stored = dataset[0].labels[GRIPPER].world_from_tcp[:, :3]
    drawn = batch.positives[GRIPPER].translation.numpy() + batch.nodes.centroid
    distance = np.linalg.norm(drawn[:, None] - stored[None], axis=-1).min(1)
    assert distance.max() < 1e-6


def test_record_nodes_can_forget_gravity():
    assert not record_nodes(record(0), drop_gravity=True).gravity.any()
    assert record_nodes(record(0)).gravity[2] == -1


def test_errors_say_what_to_do(data, tmp_path):
    with pytest.raises(InvalidRequestError, match=r"'huge' is unknown.*base.*small.*tiny"):
        TrainConfig(preset="huge")
    with pytest.raises(DataError, match="cannot be resumed"):
        train(data, tmp_path, CONFIG, resume=True)
    empty = tmp_path / "empty"
    SceneWriter(empty, {"config": "test"}).close()
    with pytest.raises(DataError, match="expected at least 2"):
        train(empty, tmp_path / "out", CONFIG)

"""The model's own samples, tried in the scenes they were drawn for."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
import torch

from megrasp_core.cli import main
from megrasp_core.diffusion import SamplerSettings, sample_steps
from megrasp_core.errors import DataError
from megrasp_core.evaluation.collision_causes import CollisionCauses
from megrasp_core.evaluation.sample_rates import sample_rates
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import PoseBatch, pose7_from_matrix
from megrasp_core.network import PRESETS, GraspModel, save_model
from megrasp_core.objects import ObjectSet
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.self_labelling.samples import (
    SampleSettings,
    draw_poses,
    judge_poses,
    label_samples,
    world_of,
)
from megrasp_core.simulation import Bin
from megrasp_core.storage import Kind, SceneDataset, SceneRecord, SceneWriter

SETTINGS = SampleSettings(
    samples=6, judged=2, colliding=3, sampler=SamplerSettings(steps=2, restarts=0)
)


@pytest.fixture(scope="module")
def record() -> SceneRecord:
    """One procedural object resting on a table, and its surface as points."""
    objects = ObjectSet(())
    model = objects["procedural/000003"]
    pose = np.eye(4)
    pose[2, 3] = -model.vertices[:, 2].min()
    points = (model.vertices + pose[:3, 3]).astype(np.float16)
    return SceneRecord(
        name="scene_0000000001",
        seed=1,
        object_names=("procedural/000003",),
        object_poses=pose7_from_matrix(pose[None]).astype(np.float32),
        obstacle=np.zeros(1, bool),
        bin=None,
        points=points,
        normals=np.tile([0, 0, 127], (len(points), 1)).astype(np.int8),
        on_plane=np.zeros(len(points), bool),
        sensor=np.array([0, 0, 0.8], np.float32),
        gravity=np.array([0, 0, -1], np.float32),
    )


def test_poses_get_the_verdict_of_the_scene(record):
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    in_the_air, in_the_table = down.copy(), down.copy()
    in_the_air[2, 3], in_the_table[2, 3] = 0.5, -0.1
    labels = judge_poses(
        record,
        load_gripper("robotiq_2f85"),
        ObjectSet(()),
        np.stack([in_the_air, in_the_table]),
        SETTINGS,
    )
    assert labels.label.tolist() == [0, 0]
    assert labels.reason.tolist() == ["no_contact", "start_collision"]
    assert set(labels.kind.tolist()) == {int(Kind.SAMPLED)}


def test_a_collision_on_the_way_is_told_from_one_at_the_start(record):
    upwards = np.eye(4)
    upwards[2, 3] = 0.4  # free there, and 0.4 m back, below, the table is in the way
    settings = dataclasses.replace(SETTINGS, approach_distance=0.4)
    in_bin = dataclasses.replace(record, bin=Bin())
    gripper = load_gripper("robotiq_2f85")
    labels = judge_poses(in_bin, gripper, ObjectSet(()), upwards[None], settings)
    assert labels.reason.tolist() == ["approach_collision"]


def test_samplers_that_follow_the_score_are_given_it(record, monkeypatch):
    """And the cloud is prepared as the model was trained."""
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"]).eval()
    model.info = dataclasses.replace(model.info, scene=SceneSettings(max_nodes=16))
    asked, nodes = [], []
    encode, predict = model.encode_scene, model.predict

    def steps(denoise, starts, sampler, *rest):
        poses = PoseBatch(torch.eye(3).expand(len(starts), 3, 3), starts)
        asked.append((denoise(poses, torch.ones(len(starts))), poses))
        return sample_steps(denoise, starts, sampler, *rest)

    monkeypatch.setattr("megrasp_core.self_labelling.samples.sample_steps", steps)
    monkeypatch.setattr(model, "encode_scene", lambda of: nodes.append(of) or encode(of))
    sampler = SamplerSettings(kind="langevin", steps=2, restarts=0)
    gripper = load_gripper("robotiq_2f85")
    draw_poses(record, model, gripper, dataclasses.replace(SETTINGS, sampler=sampler))
    assert len(nodes[0].points) == 16
    (answer, poses), code = (
        asked[0],
        model.encode_gripper(gripper.tokens(model.config.gripper_tokens, seed=0)),
    )
    with torch.inference_mode():
        found = predict(encode(nodes[0]), code, poses, torch.ones(len(poses)))
    assert torch.allclose(answer[:, 3:], found.score, atol=1e-4)
    assert not torch.allclose(answer[:, 3:], found.residual[:, 3:], atol=1e-4)


def test_collisions_are_told_by_depth_and_sight(record):
    gripper = load_gripper("robotiq_2f85")
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    poses = np.stack([down] * 3)
    # The origin of the gripper is its flange: far off, 30 mm into the table, far off.
    reach = gripper.gripper_from_tcp[2, 3]
    poses[:, 2, 3] = 0.5, reach - 0.03, 0.5
    seen, unseen = CollisionCauses(), CollisionCauses()
    world = world_of(record, gripper, ObjectSet(()))
    whole = np.stack(np.meshgrid(*[np.arange(-0.1, 0.1, 0.004)] * 2, [0.0]), -1).reshape(-1, 3)
    seen.add(dataclasses.replace(record, points=whole.astype(np.float16)), world, poses)
    unseen.add(dataclasses.replace(record, points=whole[:1].astype(np.float16)), world, poses)
    assert dataclasses.astuple(seen) == (1, 1, 1, 0)
    assert dataclasses.astuple(unseen) == (1, 1, 1, 1)


def test_a_run_writes_copies_and_resumes(record, tmp_path):
    writer = SceneWriter(tmp_path / "scenes", {"config": "test"})
    for seed in (1, 2):
        writer.add(dataclasses.replace(record, seed=seed, name=f"scene_{seed:010d}"))
    writer.close()
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="tiny").eval()
    arguments = (
        tmp_path / "scenes",
        tmp_path / "samples",
        model,
        ("robotiq_2f85",),
        ObjectSet(()),
        SETTINGS,
    )
    assert label_samples(*arguments, indices=[0]) == 1
    assert label_samples(*arguments) == 1, "the scene that is there must not be made again"
    with pytest.raises(DataError, match="differs in grippers"):
        label_samples(*arguments[:3], ("franka_hand",), *arguments[4:])
    made = SceneDataset(tmp_path / "samples")
    assert len(made) == 2
    labels = made[0].labels["robotiq_2f85"]
    assert 0 < len(labels) <= SETTINGS.judged + SETTINGS.colliding
    assert np.array_equal(made[0].points, record.points)


def test_models_are_compared_by_samples_in_the_same_scenes(record, tmp_path, capsys):
    written_scenes = SceneWriter(tmp_path / "scenes", {"config": "test"})
    for seed in (1, 2):
        written_scenes.add(dataclasses.replace(record, seed=seed, name=f"scene_{seed:010d}"))
    written_scenes.close()
    sampler = SamplerSettings(steps=2, restarts=0)
    all_of_it = {"poses": 5000, "cpu_seconds": 20.0}
    heads_alone = {"poses": 0, "cpu_seconds": 3.0}
    trained: dict[str, dict[str, Any]] = {
        "one": {"counters": all_of_it},
        "two": {"counters": heads_alone, "started_from": {"counters": all_of_it}},
    }
    for name in ("one", "two"):
        torch.manual_seed(len(name))
        model = GraspModel(PRESETS["tiny"], model_id=name)
        model.info = dataclasses.replace(model.info, sampler=sampler, **trained[name])
        save_model(model, tmp_path / name / "model")
    page = tmp_path / "page.md"
    page.write_text("<!-- comparison -->\n<!-- /comparison -->\n")
    out = tmp_path / "comparison.json"
    arguments = [
        "compare", "--models", str(tmp_path / "one"), str(tmp_path / "two" / "model"), "--data",
        str(tmp_path / "scenes"), "--gripper", "robotiq_2f85", "allegro_hand", "--grasps", "5",
        "--out", str(out), "--page", str(page),
    ]  # fmt: skip
    assert main(arguments) == 0, capsys.readouterr().err
    content = json.loads(out.read_text())
    assert [row["model"] for row in content["rows"]] == ["one", "two"]
    for row in content["rows"]:
        assert (row["poses"], row["cpu_seconds"]) == (5000, 20.0)
        for name in ("robotiq_2f85", "allegro_hand"):
            rates = row[name]
            # Three samples in each of the two scenes, so that five are reached.
            assert rates["unfiltered"]["trials"] == rates["colliding"]["trials"] == 6
            assert rates["unfiltered"]["successes"] + rates["colliding"]["successes"] <= 6
            assert rates["evaluations"] == 2
            causes = rates["colliding_at_pre_grasp"]
            assert causes["over_10_mm"] <= causes["over_5_mm"] <= causes["count"] <= 6
    assert page.read_text().count("\n| ") == 8
    assert main([*arguments, "--sampler", "steps=1 restarts=0", "restarts=0"]) == 0
    rows = json.loads(out.read_text())["rows"]
    told = [
        (row["model"], row["sampled_with"], row["robotiq_2f85"]["evaluations"]) for row in rows
    ]
    assert told == [
        (name, text, count)
        for name in ("one", "two")
        for text, count in (("steps=1 restarts=0", 1), ("restarts=0", 10))
    ]
    assert "| two, restarts=0: 10 evaluations | " in page.read_text()
    assert main([*arguments, "--sampler", "step=1"]) == 2
    assert "names no field of SamplerSettings" in capsys.readouterr().err
    assert main([*arguments[:-2], "--grasps", "0"]) == 2
    assert "expected at least one each" in capsys.readouterr().err


def test_a_hand_is_compared_on_tables_alone(record):
    in_bin = dataclasses.replace(record, bin=Bin())
    model = GraspModel(PRESETS["tiny"]).eval()
    with pytest.raises(DataError, match="hold none for allegro_hand; expected tables"):
        sample_rates(model, [in_bin], "allegro_hand", ObjectSet(()), grasps=1, seed=1)

"""`megrasp finetune`: the file of grasps, what is wrong with it, and the folder that comes out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from megrasp_core.cli import main
from megrasp_core.cli.grasp_file import read_grasps
from megrasp_core.errors import MegraspError
from megrasp_core.network import PRESETS, GraspModel, load_model, save_model
from megrasp_core.pointcloud import Cloud, write_cloud

# The TCP of robotiq_2f85 lies on +Z, so that a gripper this high over the box's top holds it.
POSE = [0.0, 0.0, 0.16, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A cloud of a floor with a box on it, and the same in a camera's frame without viewpoint."""
    place = tmp_path_factory.mktemp("few")
    rng = np.random.default_rng(0)
    floor = rng.uniform((-0.15, -0.15, 0.0), (0.15, 0.15, 0.0005), (2500, 3))
    box = rng.uniform((-0.02, -0.03, 0.0495), (0.02, 0.03, 0.05), (900, 3))
    points = np.concatenate([floor, box])
    write_cloud(place / "a.npz", Cloud(points, viewpoint=np.array([0.0, 0.0, 0.8])))
    optical = points * (1, -1, -1) + (0, 0, 0.8)
    write_cloud(place / "b.ply", Cloud(optical))
    return place


def entry(**changes: object) -> dict[str, object]:
    return {"cloud": "a.npz", "world_from_gripper": POSE, **changes}


def written(folder: Path, content: object) -> Path:
    path = folder / "grasps.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_entries_are_read_as_synthesize_reads_clouds(folder):
    region = folder / "bin.yaml"
    region.write_text("pose: [0, 0, 0.075, 0, 0, 0, 1]\nsize: [0.4, 0.3, 0.15]\n")
    optical = entry(
        cloud="b.ply",
        frame="optical",
        gravity=[0, 0, 2],
        world_from_gripper=[0, 0, 0.6, 0, 0, 0, 1],
    )
    one, other = read_grasps(
        written(folder, [entry(region="bin.yaml", sensor=[0, 0, 1]), optical])
    )
    assert one.name == "a.npz" and len(one.digest) == 64
    assert one.request.region is not None and one.request.walls
    np.testing.assert_allclose(np.asarray(one.request.sensor), (0, 0, 1))
    np.testing.assert_allclose(one.pose7, POSE)
    np.testing.assert_allclose(np.asarray(other.request.gravity), (0, 0, 1))
    np.testing.assert_allclose(np.asarray(other.request.sensor), (0, 0, 0))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[", "cannot be read"),
        ({}, "holds {}; expected a JSON list"),
        ([], "holds []"),
        ([3], "entry 1: it is 3"),
        ([entry(), {"cloud": "a.npz"}], "entry 2: it has ['cloud'], lacks world_from_gripper"),
        ([entry(sensors=[0, 0, 1])], "does not know sensors"),
        ([entry(cloud=3)], "cloud 3 was given; expected a path"),
        ([entry(cloud="none.ply")], "entry 1: no cloud file"),
        ([entry(world_from_gripper=POSE[:6])], "(6 given); expected 7 finite numbers"),
        ([entry(world_from_gripper=[*POSE[:6], "x"])], "expected 7 finite numbers"),
        ([entry(world_from_gripper=[0, 0, 0.1, 0, 0, 0, 0.5])], "has the length 0.5; expected 1"),
        ([entry(sensor=[0, 1])], "sensor is [0, 1] (2 given); expected 3"),
        ([entry(frame="map")], 'frame "map" was given'),
        ([entry(frame="optical", cloud="b.ply")], "entry 1: --frame optical was given without"),
        ([entry(scale="mm")], 'scale "mm" was given'),
        ([entry(scale=1000)], "entry 1: the cloud is"),
        ([entry(region="none.yaml")], "entry 1: region file"),
    ],
)
def test_wrong_files_are_told(folder, content, words):
    with pytest.raises(MegraspError) as told:
        read_grasps(written(folder, content))
    assert words in str(told.value)


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    torch.manual_seed(0)
    random = GraspModel(PRESETS["tiny"], model_id="random")
    return save_model(random, tmp_path_factory.mktemp("m") / "random")


def run(capsys, *args: object) -> tuple[int, str, str]:
    code = main([str(arg) for arg in ("finetune", *args)])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_a_model_like_any_other_comes_out(capsys, folder, model, tmp_path, caplog):
    grasps, out = written(folder, [entry()]), tmp_path / "few"
    args = ("--gripper", "robotiq_2f85", "--grasps", grasps, "--model", model, "--out", out)
    code, _, told = run(capsys, *args)
    assert code == 2 and "1 grasps were given; expected at least 3" in told
    code, said, _ = run(
        capsys, *args, "--steps", 1, "--seed", 4, "--report", tmp_path / "report.json",
        "--set", "poses_per_scene=4", "head_poses=2", "node_sets=1", "validation_poses=16",
    )  # fmt: skip
    assert code == 0 and str(out) in said
    assert any("too few to leave any out" in record.message for record in caplog.records)
    info = load_model(out).info
    assert info.model_id == "random-robotiq_2f85"
    assert not info.trained_grippers, "so that the score stays that of an untrained gripper"
    assert info.started_from["model_id"] == "random"
    facts = info.finetuned
    assert facts["steps"] == 1 and facts["settings"]["seed"] == 4
    assert facts["grasps"][0]["sha256"] == read_grasps(grasps)[0].digest
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["written"] and report["grasps"] == facts["grasps"]
    card = (out / "MODEL_CARD.md").read_text()
    assert "robotiq_2f85" in card and "nothing shows that the model is better" in card
    code, _, told = run(capsys, *args)
    assert code == 2 and "holds a model already" in told


def test_unknown_grippers_and_far_grasps_are_told(capsys, folder, model, tmp_path):
    args = ("--model", model, "--out", tmp_path / "none")
    grasps = written(folder, [entry()])
    code, _, told = run(capsys, "--gripper", "no_such", "--grasps", grasps, *args)
    assert code == 2 and "unknown gripper 'no_such'" in told
    far = written(folder, [entry(world_from_gripper=[0.0, 0.0, 160.0, *POSE[3:]])])
    code, _, told = run(capsys, "--gripper", "robotiq_2f85", "--grasps", far, *args)
    assert code == 2 and "a.npz: the TCP of the grasp is" in told and "in millimetres" in told
    assert not (tmp_path / "none").exists()

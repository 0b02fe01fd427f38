"""`megrasp synthesize` from depth images with masks, and from several views."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from megrasp_core.cli import main
from megrasp_core.network import PRESETS, GraspModel, save_model
from megrasp_core.pointcloud import Cloud, write_cloud

INTRINSICS = ("--intrinsics", "300", "300", "160", "120")


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """Folder of a small model with random weights."""
    torch.manual_seed(0)
    return save_model(
        GraspModel(PRESETS["tiny"], model_id="random"), tmp_path_factory.mktemp("m") / "random"
    )


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> Path:
    """depth.png (mm) of two boxes on a floor 0.7 m below the camera, mask.png with 1 and 2."""
    folder = tmp_path_factory.mktemp("d")
    depth = np.full((240, 320), 700, dtype=np.uint16)
    mask = np.zeros((240, 320), dtype=np.uint8)
    for label, column in ((1, 90), (2, 210)):
        depth[100:140, column : column + 20] = 640
        mask[100:140, column : column + 20] = label
    depth[:3, :3] = 0
    Image.fromarray(depth).save(folder / "depth.png")
    Image.fromarray(mask).save(folder / "mask.png")
    return folder


def run(capsys, *args: object) -> tuple[int, str, str]:
    code = main([str(a) for a in args])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_grasps_of_a_depth_image_say_which_object_they_take(capsys, model, images, tmp_path):
    out = tmp_path / "grasps.json"
    code, said, _ = run(
        capsys, "synthesize", "--depth", images / "depth.png", *INTRINSICS, "--top-down",
        "--mask", images / "mask.png", "--target", "2", "--gripper", "franka_hand", "-n", 20,
        "--drawn", 20, "--all", "--model", model, "--seed", 3, "--out", out,
    )  # fmt: skip
    content = json.loads(out.read_text())
    assert code in (0, 1)
    assert content["frame"] == "optical"
    assert len(content["grasps"]) == 20
    for grasp in content["grasps"]:
        assert grasp["object"] in (1, 2, None)
        assert grasp["object"] == 2 or not grasp["collision_free"]
    # A model with random weights: the starts are at the target, and few leave it.
    at = np.array([grasp["world_from_tcp"][:3] for grasp in content["grasps"]])
    assert np.median(at[:, 0]) > 0.02
    assert "not returned:" in said


def test_a_target_that_is_not_there_lists_those_that_are(capsys, model, images):
    code, _, told = run(
        capsys, "synthesize", "--depth", images / "depth.png", *INTRINSICS, "--top-down",
        "--mask", images / "mask.png", "--target", "7", "--gripper", "franka_hand",
        "--model", model,
    )  # fmt: skip
    assert code == 2
    assert "target 7" in told and "1, 2" in told


def view(place: tuple[float, float, float], path: Path, *, told: bool = True) -> Path:
    rng = np.random.default_rng(0)
    floor = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (6000, 3))
    box = rng.uniform((-0.02, -0.03, 0.0495), (0.02, 0.03, 0.05), (2000, 3))
    points = np.concatenate([floor, box])
    write_cloud(path, Cloud(points, None, np.array(place) if told else None))
    return path


def test_several_views_need_their_sensors(capsys, model, tmp_path):
    left = view((-0.3, 0.0, 0.8), tmp_path / "left.npz")
    right = view((0.3, 0.0, 0.8), tmp_path / "right.npz", told=False)
    options = ("--gripper", "franka_hand", "-n", 4, "--drawn", 4, "--model", model)
    code, _, told = run(capsys, "synthesize", left, right, *options)
    assert code == 2
    assert "right.npz" in told and "viewpoint" in told
    right = view((0.3, 0.0, 0.8), tmp_path / "right.npz")
    assert run(capsys, "synthesize", left, right, *options)[0] in (0, 1)
    assert run(capsys, "synthesize", "--cloud", left, "--cloud", right, *options)[0] in (0, 1)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ((), "neither a cloud nor --depth"),
        (("a.ply", "--depth", "d.png"), "one of them"),
        (("a.ply", "--mask", "m.png"), "without --depth"),
        (("a.ply", "--intrinsics", "1", "1", "1", "1"), "--intrinsics was given without"),
        (("--depth", "d.png"), "gravity"),
        (("--depth", "d.png", "--top-down"), "no file d.png"),
        (("a.ply", "--min-score", "2"), "min_score 2"),
        (("a.ply", "--target", "0"), "target 0"),
    ],
)
def test_wrong_sources_are_exit_code_2(capsys, model, args, words):
    code, _, told = run(capsys, "synthesize", *args, "--gripper", "franka_hand", "--model", model)
    assert code == 2
    assert words in told


def test_views_that_are_not_in_one_frame_are_refused(capsys, model, tmp_path):
    options = ("--gripper", "franka_hand", "--model", model)
    left = view((-0.3, 0.0, 0.8), tmp_path / "left.npz")
    rng = np.random.default_rng(1)
    # The same table as a camera 0.8 m over it has it: z forward, itself the origin.
    ahead = rng.uniform((-0.2, -0.15, 0.75), (0.2, 0.15, 0.8), (6000, 3))
    for name in ("a.npz", "b.npz"):
        write_cloud(tmp_path / name, Cloud(ahead, None, np.zeros(3)))
    code, _, told = run(capsys, "synthesize", left, tmp_path / "a.npz", *options)
    assert code == 2 and "seems to be a camera's" in told
    both = (tmp_path / "a.npz", tmp_path / "b.npz", "--frame", "optical", "--top-down")
    code, _, told = run(capsys, "synthesize", *both, *options)
    assert code == 2 and "own camera's frame" in told and "--sensor 0 0 0" in told
    below = view((0.3, 0.0, -0.8), tmp_path / "below.npz")
    code, _, told = run(capsys, "synthesize", left, below, *options)
    assert code == 2 and "lies below what it sees" in told


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ("300 300 320 240", "outside the image of 320 x 240"),
        ("300 160 300 120", "The order is fx fy cx cy"),
        ("150 150 80 60", "an image of about 160 x 120: scale all four by 2"),
    ],
)
def test_intrinsics_of_another_image_are_refused(capsys, model, images, numbers, words):
    code, _, told = run(
        capsys, "synthesize", "--depth", images / "depth.png", "--intrinsics", *numbers.split(),
        "--top-down", "--gripper", "franka_hand", "--model", model,
    )  # fmt: skip
    assert code == 2 and words in told


def test_labels_are_not_cut_short(capsys, model, images, tmp_path):
    labels = np.full((240, 320), 2**33 + 1, np.int64)
    np.save(tmp_path / "mask.npy", labels)
    code, _, told = run(
        capsys, "synthesize", "--depth", images / "depth.png", *INTRINSICS, "--top-down",
        "--mask", tmp_path / "mask.npy", "--target", "1", "--gripper", "franka_hand",
        "--model", model,
    )  # fmt: skip
    assert code == 2 and "8589934593" in told


@pytest.mark.parametrize(
    ("region", "words"),
    [
        ('pose: [0, 0, 0, 0, 0, 0, 1]\nsize: [0.4, 0.3, 0.15]\nwalls: "false"', "walls: 'false'"),
        ("pose: [0, 0, 0, 0, 0, 0, 1]\nsize: [400, 300, 150]", "looks like millimetres"),
    ],
)
def test_regions_that_are_not_meant_so(capsys, model, tmp_path, region, words):
    (tmp_path / "bin.yaml").write_text(region)
    seen = view((0.0, 0.0, 0.8), tmp_path / "a.npz")
    code, _, told = run(
        capsys, "synthesize", seen, "--region", tmp_path / "bin.yaml", "--gripper",
        "franka_hand", "--model", model,
    )  # fmt: skip
    assert code == 2 and words in told

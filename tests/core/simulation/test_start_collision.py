"""Penetration of the open gripper, one pose and many."""

from __future__ import annotations

import numpy as np
import pytest
from jaw_and_boxes import Jaw, at, down, make_box

from megrasp_core.simulation import Bin, World, approach_path, build_world, start_depths


@pytest.fixture
def world(jaw: Jaw) -> World:
    return build_world(
        [make_box((0.04, 0.06, 0.05)), make_box((0.05, 0.05, 0.05))],
        gripper=jaw,
        bin=Bin(),
        object_poses=np.stack([at(0, 0, 0.025), at(0.0, 0.02, 0.0749)]),
    )


@pytest.mark.parametrize(
    ("pose", "depth"),
    [
        (down(0.025, -0.03, 0.01), 0.005),
        (down(0.023, -0.1, 0.01), 0.0),
        (down(0.0, -0.1, -0.002), 0.002),
        (down(0.153, -0.1, 0.05), 0.003),
        (down(0.0, 0.02, 0.0649), 0.0),
    ],
    ids=["box", "free", "table", "bin wall", "around the upper box"],
)
def test_depth_is_measured(world: World, pose: np.ndarray, depth: float) -> None:
    assert start_depths(world, pose[None])[0] == pytest.approx(depth, abs=2e-4)


def test_many_poses_agree_with_one_and_leave_the_world_alone(world: World) -> None:
    rng = np.random.default_rng(0)
    poses = np.stack(
        [down(*rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.1]), yaw=a) for a in range(40)]
    )
    before = world.save().vector
    masks = [
        np.array(getattr(world.model, name))
        for name in ("geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity")
    ]
    depths = start_depths(world, poses)
    assert np.array_equal(world.save().vector, before)
    for mask, name in zip(
        masks, ("geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity")
    ):
        assert np.array_equal(mask, getattr(world.model, name))
    single = []
    for pose in poses:
        world.place_gripper(pose)
        single.append(world.gripper_depth())
    assert depths == pytest.approx(np.array(single), abs=1e-9)
    assert 0.1 < (depths > 0.001).mean() < 0.9


def test_approach_path_runs_from_the_stand_off_to_before_the_pregrasp() -> None:
    path = approach_path(down(0, 0, 0.11), down(0, 0, 0.01), 10)
    assert path.shape == (10, 4, 4)
    assert path[0] == pytest.approx(down(0, 0, 0.11))
    assert path[-1] == pytest.approx(down(0, 0, 0.02))

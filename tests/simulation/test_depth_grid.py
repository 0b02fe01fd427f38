"""The quick collision test: never stricter than the exact one, and worth its while."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import load_gripper
from megrasp_core.objects import procedural_object
from megrasp_core.simulation import Bin, World, build_world, settle, start_depths
from megrasp_core.simulation.depth_grid import SPACING, DepthGrid, GripperPoints

POSES = 400


@pytest.fixture(scope="module", params=["bin", "table"])
def scene(request: pytest.FixtureRequest) -> tuple[World, str]:
    """A settled heap with a gripper."""
    bin = Bin() if request.param == "bin" else None
    models = [procedural_object(seed) for seed in range(6)]
    settled = settle(models, bin=bin, rng=np.random.default_rng(0))
    return settled.world(gripper=load_gripper("robotiq_2f85")), request.param


def steep_poses(count: int) -> np.ndarray:
    """Grippers (n, 4, 4) pointing about down, their fingertips somewhere in the heap."""
    rng = np.random.default_rng(1)
    pose = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    turn = Rotation.from_rotvec(rng.normal(size=(count, 3)) * [0.3, 0.3, 2.0]).as_matrix()
    pose[:, :3, :3] = turn @ pose[:, :3, :3]
    tip = rng.uniform([-0.2, -0.15, -0.01], [0.2, 0.15, 0.12], size=(count, 3))
    pose[:, :3, 3] = tip - 0.15 * pose[:, :3, 2]
    return pose


def test_what_it_rejects_collides_and_it_rejects_most(scene: tuple[World, str]) -> None:
    world, _ = scene
    poses = steep_poses(POSES)
    exact = start_depths(world, poses) > 0.001
    quick = DepthGrid.of(world).collides(poses, GripperPoints.of(world.gripper))
    assert exact.sum() > POSES // 4
    assert not (quick & ~exact).any()
    assert quick.sum() > 0.7 * exact.sum()


def test_depths_are_those_of_the_shapes() -> None:
    """The middle of a wall and of a box, just inside a face, and outside."""
    bin = Bin((0.3, 0.2, 0.1), wall=0.02)
    grid = DepthGrid.of(build_world([], bin=bin))
    points = np.array([[0.16, 0.0, 0.05], [0.156, 0.0, 0.05], [0.0, 0.0, 0.05]], np.float32)
    cell = np.rint((points - grid.low) / SPACING).astype(int)
    depth = grid.depth[tuple(cell.T)]
    np.testing.assert_allclose(depth, [0.010, 0.006, 0.0], atol=SPACING)
    assert depth[2] == 0.0 and grid.floor == 0.0


def test_parked_objects_and_the_gripper_are_not_in_the_grid() -> None:
    world = build_world([procedural_object(0)], gripper=load_gripper("robotiq_2f85"))
    grid = DepthGrid.of(world)
    assert not grid.depth.any()
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.5
    points = GripperPoints.of(load_gripper("robotiq_2f85"))
    assert not grid.collides(pose[None], points).any()
    pose[2, 3] = 0.1
    assert grid.collides(pose[None], points).all()

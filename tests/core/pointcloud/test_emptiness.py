"""Is the bin empty? Objects of any size that can be grasped count, noise and walls do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.errors import GravityError
from megrasp_core.pointcloud import OrientedBox, check_not_upside_down, only_support_left

REGION = OrientedBox.around([0, 0, 0.075], [0.4, 0.3, 0.15])
DOWN = np.array([0.0, 0.0, -1.0])


def bin_cloud(noise: float = 0.001, walls: bool = True, seed: int = 0) -> np.ndarray:
    """Return the floor and the inner sides of the bin of REGION, as a camera above sees them."""
    rng = np.random.default_rng(seed)
    parts = [rng.uniform((-0.2, -0.15, 0), (0.2, 0.15, 0), (20000, 3))]
    if walls:
        for axis, sign in ((0, -1), (0, 1), (1, -1), (1, 1)):
            side = rng.uniform((-0.2, -0.15, 0), (0.2, 0.15, 0.15), (1500, 3))
            side[:, axis] = sign * (0.2, 0.15)[axis]
            parts.append(side)
    points = np.concatenate(parts)
    return points + rng.normal(0, noise, points.shape)


def block(size: tuple[float, float, float], at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return the top and two sides of a block on the floor."""
    rng = np.random.default_rng(1)
    top = rng.uniform((-0.5, -0.5, 1), (0.5, 0.5, 1), (600, 3)) * size
    side = rng.uniform((-0.5, -0.5, 0), (-0.5, 0.5, 1), (300, 3)) * size
    return np.concatenate([top, side]) + np.array([*at, 0])


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
@pytest.mark.parametrize("walls", [True, False])
def test_an_empty_bin_is_empty(noise: float, walls: bool) -> None:
    assert only_support_left(bin_cloud(noise, walls), REGION, DOWN)


@pytest.mark.parametrize("size", [(0.03, 0.03, 0.02), (0.15, 0.01, 0.02), (0.06, 0.06, 0.10)])
@pytest.mark.parametrize("at", [(0.0, 0.0), (0.16, 0.11)])
def test_one_object_is_enough(size: tuple[float, float, float], at: tuple[float, float]) -> None:
    assert not only_support_left(np.concatenate([bin_cloud(), block(size, at)]), REGION, DOWN)


def test_what_lies_outside_the_region_does_not_count() -> None:
    outside = np.concatenate([bin_cloud(), block((0.05, 0.05, 0.05), (0.4, 0.0))])
    assert only_support_left(outside, REGION, DOWN)
    assert not only_support_left(outside, None, DOWN)


def test_a_bin_that_is_full_to_the_walls_is_not_empty() -> None:
    rng = np.random.default_rng(2)
    heap = rng.uniform((-0.2, -0.15, 0.03), (0.2, 0.15, 0.12), (20000, 3))
    assert not only_support_left(heap, REGION, DOWN)


def test_the_answer_turns_with_the_scene() -> None:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([1.9, -0.4, 0.7]).as_matrix()
    turn[:3, 3] = 0.3, -1.0, 0.6
    for extra, empty in ((np.empty((0, 3)), True), (block((0.04, 0.04, 0.04)), False)):
        points = np.concatenate([bin_cloud(), extra]) @ turn[:3, :3].T + turn[:3, 3]
        assert only_support_left(points, REGION.transformed(turn), turn[:3, :3] @ DOWN) == empty


def test_objects_that_hang_under_the_surface_are_no_empty_table() -> None:
    table = np.concatenate([bin_cloud(walls=False), block((0.05, 0.05, 0.06), (0.08, 0.05))])
    hanging = table * [1, 1, -1]
    assert only_support_left(hanging, None, DOWN)
    with pytest.raises(GravityError, match="hang under it"):
        check_not_upside_down(hanging, DOWN)
    ground = np.random.default_rng(2).uniform((0.25, -0.4, -0.2), (0.6, 0.4, -0.2), (900, 3))
    check_not_upside_down(np.concatenate([bin_cloud(walls=False), ground]), DOWN)

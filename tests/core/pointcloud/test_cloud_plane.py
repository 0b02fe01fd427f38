"""The support plane."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.pointcloud import PlaneSettings, support_plane, voxel_means

DOWN = np.array([0.0, 0.0, -1.0])


def noisy(points: np.ndarray, sigma: float = 0.001) -> np.ndarray:
    return voxel_means(points + np.random.default_rng(5).normal(0, sigma, points.shape), 0.004)


@pytest.mark.parametrize("gravity", [DOWN, None])
def test_table_under_clutter(heap, gravity: np.ndarray | None) -> None:
    plane = support_plane(noisy(heap.points), gravity, sensor=heap.sensor)
    assert plane is not None
    assert np.degrees(np.arccos(plane.normal[2])) < 0.5
    assert abs(plane.offset) < 0.0015
    boxes = heap.points[(heap.owner > 0) & (heap.normals[:, 2] > 0.9)]
    assert (plane.height(boxes) > 0.02).all()


@pytest.mark.parametrize("gravity", [DOWN, None])
def test_plane_moves_with_the_frame(heap, motion: np.ndarray, gravity) -> None:
    points, rotation = noisy(heap.points), motion[:3, :3]
    plane = support_plane(points, gravity, sensor=heap.sensor)
    moved = support_plane(
        points @ rotation.T + motion[:3, 3],
        None if gravity is None else rotation @ gravity,
        sensor=rotation @ heap.sensor + motion[:3, 3],
    )
    assert plane is not None and moved is not None
    np.testing.assert_allclose(moved.normal, rotation @ plane.normal, atol=1e-3)
    height = moved.height(points @ rotation.T + motion[:3, 3])
    np.testing.assert_allclose(height, plane.height(points), atol=5e-4)


@pytest.mark.parametrize("degrees", [1.0, 3.0, 5.0])
def test_a_tilt_between_gravity_and_table_is_absorbed(heap, degrees: float) -> None:
    tilt = Rotation.from_euler("xy", [degrees, 0], degrees=True).as_matrix()
    plane = support_plane(noisy(heap.points), tilt @ DOWN)
    assert plane is not None and np.degrees(np.arccos(plane.normal[2])) < 0.5


def test_the_table_wins_over_a_larger_box_top(render) -> None:
    pose = np.eye(4)
    pose[2, 3] = 0.05
    picture = render([(pose, np.array([0.5, 0.5, 0.1]))], table=0.32)
    points = noisy(picture.points, 0.0005)
    on_top = np.mean(points[:, 2] > 0.09)
    assert on_top > 0.5
    plane = support_plane(points, DOWN)
    assert plane is not None and abs(plane.offset) < 0.002


def test_no_plane_in_a_heap_without_a_floor() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(6000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = np.abs(directions[:, 2])
    centres = rng.uniform(-0.1, 0.1, (30, 3)) * [1, 1, 0.5]
    points = voxel_means(directions * 0.03 + centres[rng.integers(30, size=6000)], 0.004)
    assert support_plane(points, DOWN) is None
    assert support_plane(points[:20], DOWN) is None


def test_a_wall_is_no_support() -> None:
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.zeros(4000), rng.uniform(0, 0.3, (4000, 2))])
    assert support_plane(voxel_means(wall, 0.004), DOWN) is None


def test_settings_bound_the_share(heap) -> None:
    assert support_plane(noisy(heap.points), DOWN, settings=PlaneSettings(min_share=0.99)) is None

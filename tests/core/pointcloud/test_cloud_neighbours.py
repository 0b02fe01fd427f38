"""Neighbours, outliers, normals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from megrasp_core.errors import CloudError
from megrasp_core.pointcloud import neighbours, voxel_means
from megrasp_core.pointcloud.knn import (
    local_normals,
    oriented,
    outlier_mask,
    smallest_eigenvectors,
)


def test_neighbours_equal_the_full_distance_matrix() -> None:
    rng = np.random.default_rng(0)
    points, queries = rng.normal(size=(400, 3)), rng.normal(size=(30, 3))
    distance, index = neighbours(queries, points, 7)
    full = cdist(queries, points)
    np.testing.assert_allclose(distance, np.sort(full, axis=1)[:, :7])
    np.testing.assert_array_equal(index, np.argsort(full, axis=1)[:, :7])
    assert neighbours(queries, points[:3], 9)[1].shape == (30, 3)
    assert neighbours(queries, points[:1], 1)[1].shape == (30, 1)
    with pytest.raises(CloudError, match="no points to search"):
        neighbours(queries, points[:0], 3)


def estimate_normals(points: np.ndarray, sensor: ArrayLike, k: int = 16) -> np.ndarray:
    """Normals (N, 3) from the k nearest points, turned to the sensor, as a surface has them."""
    return oriented(local_normals(points, neighbours(points, points, k)[1]), points, sensor)


def test_outliers_go_and_the_surface_stays() -> None:
    x, y = np.meshgrid(np.arange(40) * 0.004, np.arange(40) * 0.004)
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    stray = np.array([[0.08, 0.08, 0.1], [0.02, 0.05, -0.07], [0.3, 0.3, 0.3]])
    points = np.concatenate([sheet, stray])
    keep = outlier_mask(neighbours(points, points, 9)[0], 3.0)
    assert keep[:-3].all() and not keep[-3:].any()
    assert outlier_mask(np.zeros((2, 1)), 3.0).all()


@pytest.mark.parametrize(
    "values", [(1, 0.5, 1e-4), (1, 0.5, 0), (1, 1, 1e-9), (1, 0.5, 0.499), (1, 1e-8, 1e-9)]
)
def test_smallest_eigenvectors_equal_lapack(values: tuple[float, float, float]) -> None:
    turns = Rotation.random(100, random_state=1).as_matrix()
    matrices = 1e-6 * np.einsum("nij,j,nkj->nik", turns, np.array(values, float), turns)
    alignment = np.abs(np.einsum("ni,ni->n", smallest_eigenvectors(matrices), turns[:, :, 2]))
    assert alignment.min() > 1 - 1e-6


def test_degenerate_patches_still_give_unit_vectors() -> None:
    line = np.column_stack([np.arange(20) * 0.01, np.zeros(20), np.zeros(20)])
    for points in (line, np.zeros((20, 3)), line[:1], line[:2]):
        normals = estimate_normals(points, [0, 0, 1], 8)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    assert np.abs(estimate_normals(line, [0, 0, 1], 8)[:, 0]).max() < 1e-6


def test_normals_of_a_rendered_heap(heap) -> None:
    rng = np.random.default_rng(0)
    points = voxel_means(heap.points + rng.normal(0, 2e-4, heap.points.shape), 0.004)
    normals = estimate_normals(points, heap.sensor, 16)
    towards = heap.sensor - points
    assert ((normals * towards).sum(axis=1) >= 0).all()
    nearest = neighbours(points, heap.points, 1)[1][:, 0]
    angle = np.degrees(np.arccos(np.clip((normals * heap.normals[nearest]).sum(axis=1), -1, 1)))
    # Edges blend two faces; away from them the normal is that of the face.
    assert np.median(angle) < 3 and np.mean(angle < 15) > 0.85


def test_each_view_turns_the_normals_of_its_points() -> None:
    rng = np.random.default_rng(0)
    sheet = np.column_stack([rng.uniform(-0.1, 0.1, (400, 2)), np.zeros(400)])
    views = np.where(sheet[:, :1] > 0, [[0.0, 0.0, 1.0]], [[0.0, 0.0, -1.0]])
    normals = estimate_normals(sheet, views)
    np.testing.assert_allclose(normals[:, 2], np.where(sheet[:, 0] > 0, 1, -1), atol=1e-9)


def test_normals_turn_with_the_cloud(heap, motion: np.ndarray) -> None:
    points = voxel_means(heap.points, 0.004)
    rotation, translation = motion[:3, :3], motion[:3, 3]
    before = estimate_normals(points, heap.sensor)
    after = estimate_normals(
        points @ rotation.T + translation, rotation @ heap.sensor + translation
    )
    # Points at equal distance (a regular table) may enter the patch in another order.
    assert np.mean(np.abs(after - before @ rotation.T).max(axis=1) < 1e-6) > 0.98


def test_threads_change_no_neighbour():
    points = np.random.default_rng(3).random((500, 3))
    one, two = (neighbours(points, points, 16, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])

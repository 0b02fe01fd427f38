"""The renderer: outer surface of a posed gripper by casting rays at it from all around (DESIGN
section 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import fpsample
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
DIRECTIONS = 40
OVERSAMPLING = 4
STAND_OFF = 1e-4
STEEP = 6
GRAZING = 0.05


@dataclass(frozen=True)
class SurfaceSample:
    """Outer surface points (N, 3), outward unit normals (N, 3), index (N,) of the mesh each point
    lies on.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    mesh: NDArray[np.int64]


def render_cloud(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """Return `count` evenly spread points of the outer surface; the same seed gives the same
    points.

    Args:
        meshes: (vertices (V, 3), faces (F, 3)) of the posed geoms, metres.
        count: number of points, at least 1.
        seed: seed of the area-weighted draw.

    Raises:
        ValueError: no mesh has any area.
    """
    sample = visible(meshes, draw(meshes, OVERSAMPLING * count, seed))
    while len(sample.points) < count:
        extra = visible(
            meshes, draw(meshes, 2 * OVERSAMPLING * count, seed + len(sample.points) + 1)
        )
        sample = SurfaceSample(
            np.concatenate([sample.points, extra.points]),
            np.concatenate([sample.normals, extra.normals]),
            np.concatenate([sample.mesh, extra.mesh]),
        )
    return take(sample, farthest(sample.points, count))


def farthest(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return the indices of `count` farthest points, from the one farthest from the mean."""
    start = int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    return fpsample.fps_sampling(points, count, start_idx=start).astype(np.int64)


def take(sample: SurfaceSample, index: NDArray[np.int64] | NDArray[np.bool_]) -> SurfaceSample:
    """Return the chosen points of a sample."""
    return SurfaceSample(sample.points[index], sample.normals[index], sample.mesh[index])


def draw(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """Draw `count` points on all triangles, area weighted, with the triangles' normals as they are
    wound.
    """
    triangles = np.concatenate([vertices[faces] for vertices, faces in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(faces) for _, faces in meshes])
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    if not len(area) or area.sum() <= 0.0:
        raise ValueError(
            "the gripper has no surface to render; expected at least one mesh with an area"
        )
    rng = np.random.default_rng(seed)
    # Stratified draw: evenly spaced along the cumulative area, so that small parts get their share
    # every time.
    edges = np.cumsum(area) / area.sum()
    ticks = (np.arange(count) + rng.random(count)) / count
    chosen = np.minimum(np.searchsorted(edges, ticks), len(area) - 1)
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    corner = triangles[chosen]
    points = (
        (1.0 - root) * corner[:, 0] + root * (1.0 - v) * corner[:, 1] + root * v * corner[:, 2]
    )
    return SurfaceSample(
        points, cross[chosen] / np.maximum(area[chosen, None], 1e-30), owner[chosen]
    )


def visible(meshes: Sequence[Mesh], sample: SurfaceSample) -> SurfaceSample:
    """Keep the points that a ray from outside reaches; turn their normals towards where they were
    seen from.

    For each direction a ray leaves the point to the outside (the reverse of a camera's ray at it);
    a point whose every ray is stopped by the gripper itself is inside.
    """
    scene = raycasting_scene(meshes)
    directions = sphere_directions(DIRECTIONS)
    cosine = sample.normals @ directions.T
    # Most points are seen along the direction nearest to their normal, most of the others along
    # one near it; only what is left needs every direction.
    seen = _escapes(scene, sample, np.arange(len(cosine)), directions[cosine.argmax(axis=1)], 1.0)
    left = np.flatnonzero(~seen)
    steep = np.argpartition(-cosine[left], STEEP, axis=1)[:, :STEEP]
    point = np.repeat(left, STEEP)
    free = _escapes(scene, sample, point, directions[steep.ravel()], 1.0)
    seen[point[free]] = True
    normals = sample.normals.copy()
    tried = steep[~seen[left]]
    left = np.flatnonzero(~seen)
    worth = np.abs(cosine[left]) > GRAZING
    np.put_along_axis(worth, tried, False, axis=1)
    row, column = np.nonzero(worth)
    point = left[row]
    side = np.sign(cosine[point, column])
    free = _escapes(scene, sample, point, directions[column], side)
    votes = np.zeros(len(seen), np.int64)
    np.add.at(votes, point[free], side[free].astype(np.int64))
    seen[point[free]] = True
    normals[votes < 0] *= -1.0
    return take(SurfaceSample(sample.points, normals, sample.mesh), seen)


def _escapes(
    scene: o3d.t.geometry.RaycastingScene,
    sample: SurfaceSample,
    point: NDArray[np.int64],
    direction: NDArray[np.float64],
    side: NDArray[np.float64] | float,
) -> NDArray[np.bool_]:
    """Return which rays (K,) from just off the surface hit nothing; `side` (K,), or one for all,
    is 1 outside, -1 inside of it.
    """
    origin = sample.points[point] + STAND_OFF * np.reshape(side, (-1, 1)) * sample.normals[point]
    rays = np.concatenate([origin, direction], axis=1).astype(np.float32)
    return ~scene.test_occlusions(o3d.core.Tensor.from_numpy(rays)).numpy()


def raycasting_scene(meshes: Sequence[Mesh]) -> o3d.t.geometry.RaycastingScene:
    """Return a single-threaded ray casting scene of the meshes."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for vertices, faces in meshes:
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, np.uint32)),
        )
    return scene


def sphere_directions(count: int) -> NDArray[np.float64]:
    """Return `count` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)

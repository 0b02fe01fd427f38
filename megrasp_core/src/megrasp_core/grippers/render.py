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

from .thinning import thinned

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
# What else the points depend on: raise the number when the same input gives others.
RENDERER = f"1, numpy {np.__version__}, open3d {o3d.__version__}, fpsample {fpsample.__version__}"
DIRECTIONS = 40
OVERSAMPLING = 4
STAND_OFF = 1e-4
STEEP = 5
GRAZING = 0.05
LOOSE = 0.25
TREE_HEIGHT = 5
# Points drawn for each that is wanted: in one go, and before the search for more is given up.
LARGEST_DRAW = 64
HOPELESS = 2000


@dataclass(frozen=True)
class SurfaceSample:
    """Outer surface points (N, 3), outward unit normals (N, 3), index (N,) of the mesh each point
    lies on.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    mesh: NDArray[np.int64]


def render_cloud(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """Return `count` evenly spread points of the outer surface; on one machine the same seed gives
    the same points.

    Args:
        meshes: (vertices (V, 3), faces (F, 3)) of the posed geoms, metres. Very many triangles
            are thinned first.
        count: number of points, at least 1.
        seed: seed of the area-weighted draw.

    Raises:
        ValueError: no mesh has any area, a vertex is not finite, or next to nothing of the
            surface can be seen.
    """
    meshes = thinned(meshes)
    scene = raycasting_scene(meshes)
    drawn, more = OVERSAMPLING * count, 2 * OVERSAMPLING * count
    sample = _outer(scene, draw(meshes, drawn, seed))
    while len(sample.points) < count:
        if drawn > HOPELESS * count:
            raise ValueError(
                f"{len(sample.points)} of {drawn} points drawn on the gripper's triangles can be "
                f"seen from outside and {count} are needed; expected visual geometry that can be "
                "seen: leave inner parts out"
            )
        extra = _outer(scene, draw(meshes, more, seed + len(sample.points) + 1))
        sample = SurfaceSample(
            np.concatenate([sample.points, extra.points]),
            np.concatenate([sample.normals, extra.normals]),
            np.concatenate([sample.mesh, extra.mesh]),
        )
        drawn += more
        more = min(2 * more, LARGEST_DRAW * count)
    return take(sample, farthest(sample.points, count))


def farthest(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return the indices of `count` farthest points, from the one farthest from the mean.

    The bucket sampler chooses as the plain one does, several times faster, but counts its start
    in the order of its own tree. An extra point has a place there that is known: the first, alone
    at the far end of a fourth coordinate. It lies opposite the wanted start, so that this one is
    next, and too far away to matter afterwards. Whether that came out is checked.
    """
    offset = points - points.mean(axis=0)
    square = (offset**2).sum(axis=1)
    start = int(np.argmax(square))
    if len(points) >= 2**TREE_HEIGHT:
        padded = np.zeros((len(points) + 1, 4), np.float32)
        padded[1:, :3] = points
        padded[0, :3] = points[start] - 3.0 * offset[start]
        padded[0, 3] = -4.0 * np.sqrt(square[start])
        index = fpsample.bucket_fps_kdline_sampling(padded, count + 1, TREE_HEIGHT, 0)
        if index[0] == 0 and index[1] == start + 1 and index[1:].min() > 0:
            return index[1:].astype(np.int64) - 1
    return fpsample.fps_sampling(points, count, start_idx=start).astype(np.int64)


def take(sample: SurfaceSample, index: NDArray[np.int64] | NDArray[np.bool_]) -> SurfaceSample:
    """Return the chosen points of a sample."""
    return SurfaceSample(sample.points[index], sample.normals[index], sample.mesh[index])


def draw(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """Draw `count` points on all triangles, area weighted, with the triangles' normals as they are
    wound.

    Raises ValueError without any area and for vertices that are not finite.
    """
    vertices, faces = _joined(meshes)
    x, y, z = np.ascontiguousarray(vertices.T)
    a, b, c = np.ascontiguousarray(faces.T)
    ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    cross = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    area = np.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2)
    total = float(area.sum())
    if not 0.0 < total < np.inf:
        raise ValueError(
            f"the gripper has no surface to render: {len(faces)} triangles of {total / 2.0} m2; "
            "expected finite vertices and at least one mesh with an area"
        )
    rng = np.random.default_rng(seed)
    # Stratified draw: evenly spaced along the cumulative area, so that small parts get their share
    # every time.
    edges = np.cumsum(area) / total
    ticks = (np.arange(count) + rng.random(count)) / count
    # Rounding may leave a tick behind the last edge: it belongs to the last triangle with an area.
    chosen = np.minimum(np.searchsorted(edges, ticks), np.searchsorted(edges, edges[-1]))
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    corner = vertices[faces[chosen]]
    points = (
        (1.0 - root) * corner[:, 0] + root * (1.0 - v) * corner[:, 1] + root * v * corner[:, 2]
    )
    normals = np.ascontiguousarray((cross[:, chosen] / area[chosen]).T)
    owner = np.searchsorted(np.cumsum([len(f) for _, f in meshes]), chosen, side="right")
    return SurfaceSample(points, normals, owner.astype(np.int64))


def visible(meshes: Sequence[Mesh], sample: SurfaceSample) -> SurfaceSample:
    """Keep the points that a ray from outside reaches; turn their normals towards where they were
    seen from.

    For each direction a ray leaves the point to the outside (the reverse of a camera's ray at it);
    a point whose every ray is stopped by the gripper itself is inside.
    """
    return _outer(raycasting_scene(meshes), sample)


def _outer(scene: o3d.t.geometry.RaycastingScene, sample: SurfaceSample) -> SurfaceSample:
    """Do what `visible` says with the meshes of a scene."""
    directions = sphere_directions(DIRECTIONS)
    rays = directions.astype(np.float32)
    ahead = (sample.points + STAND_OFF * sample.normals).astype(np.float32)
    behind = (sample.points - STAND_OFF * sample.normals).astype(np.float32)
    cosine = sample.normals @ directions.T
    # Most points are seen along the direction nearest to their normal, most of the others along
    # one near it; only what is left needs every direction.
    nearest = cosine.argmax(axis=1)
    seen = _escapes(scene, ahead, rays[nearest])
    # No ray leaves a solid backwards, but for one from next to an edge. A mesh that many leave is
    # wound the wrong way or has no inside: there the side from which more is seen counts, and no
    # shortcut.
    backwards = _escapes(scene, behind, rays[cosine.argmin(axis=1)])
    most = 1.0 + LOOSE * np.bincount(sample.mesh, seen | backwards)
    loose = (np.bincount(sample.mesh, backwards) > most)[sample.mesh]
    seen &= ~loose

    left = np.flatnonzero(~seen & ~loose)
    level = cosine[left]
    np.put_along_axis(level, nearest[left, None], 0.0, axis=1)
    steep = np.argpartition(-level, STEEP, axis=1)[:, :STEEP]
    np.put_along_axis(level, steep, 0.0, axis=1)
    cosine[left] = level
    point = np.repeat(left, STEEP)
    seen[point[_escapes(scene, ahead[point], rays[steep.ravel()])]] = True

    left = np.flatnonzero(~seen)
    votes = np.zeros(len(seen), np.int64)
    seen[left], votes[left] = _ballot(scene, (ahead[left], behind[left]), cosine[left], rays)
    normals = np.where(votes[:, None] < 0, -sample.normals, sample.normals)
    return take(SurfaceSample(sample.points, normals, sample.mesh), seen)


def _ballot(
    scene: o3d.t.geometry.RaycastingScene,
    sides: tuple[NDArray[np.float32], NDArray[np.float32]],
    cosine: NDArray[np.float64],
    rays: NDArray[np.float32],
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return whether any ray from the two `sides` (N, 3) of the points escapes, and by how many
    more do from the first than from the second (N,).

    `cosine` (N, D): between normals and rays (D, 3); those along the surface are not tried.
    """
    point, column = np.nonzero(np.abs(cosine) > GRAZING)
    back = cosine[point, column] < 0.0
    origin = np.concatenate(sides).take(point + len(cosine) * back, axis=0)
    free = _escapes(scene, origin, rays.take(column, axis=0))
    first, second = (
        np.bincount(point[free & side], minlength=len(cosine)) for side in (~back, back)
    )
    return first + second > 0, first - second


def _escapes(
    scene: o3d.t.geometry.RaycastingScene,
    origin: NDArray[np.float32],
    direction: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Return which rays (K,) from `origin` (K, 3) along `direction` (K, 3) hit nothing."""
    rays = np.concatenate([origin, direction], axis=1)
    return ~scene.test_occlusions(o3d.core.Tensor.from_numpy(rays)).numpy()


def raycasting_scene(meshes: Sequence[Mesh]) -> o3d.t.geometry.RaycastingScene:
    """Return a single-threaded ray casting scene of the meshes, joined into one geometry."""
    vertices, faces = _joined(meshes)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, np.uint32)),
    )
    return scene


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return all meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return (
        np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in meshes)]),
        np.concatenate(
            [np.zeros((0, 3), np.int64)]
            + [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
        ),
    )


def sphere_directions(count: int) -> NDArray[np.float64]:
    """Return `count` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)

"""The renderer: outer surface of a posed gripper by casting rays at it from all around."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from megrasp_core.meshes import (
    Mesh,
    RayScene,
    SurfaceSample,
    farthest_points,
    sample_stratified,
    thinned,
)

# What else the points depend on: raise the number when the same input gives others.
RENDERER = "2, " + ", ".join(
    f"{name} {version(name)}" for name in ("numpy", "embreex", "fpsample")
)
DIRECTIONS = 40
OVERSAMPLING = 4
STAND_OFF = 1e-4
STEEP = 5
GRAZING = 0.05
LOOSE = 0.25
# Points drawn for each that is wanted: in one go, and before the search for more is given up.
LARGEST_DRAW = 64
HOPELESS = 2000


def render_cloud(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """Return `count` evenly spread points of the outer surface; on one machine the same seed gives
    the same points.

    Args:
        meshes: of the posed geoms. Very many triangles are thinned first.
        count: number of points, at least 1.
        seed: seed of the area-weighted draw.

    Raises:
        ValueError: no mesh has any area, a vertex is not finite, or next to nothing of the
            surface can be seen.
    """
    meshes = thinned(meshes)
    scene = RayScene(meshes)
    drawn, more = OVERSAMPLING * count, 2 * OVERSAMPLING * count
    sample = _outer(scene, sample_stratified(meshes, drawn, seed))
    while len(sample.points) < count:
        if drawn > HOPELESS * count:
            raise ValueError(
                f"{len(sample.points)} of {drawn} points drawn on the gripper's triangles can be "
                f"seen from outside and {count} are needed; expected visual geometry that can be "
                "seen: leave inner parts out"
            )
        extra = _outer(scene, sample_stratified(meshes, more, seed + len(sample.points) + 1))
        sample = SurfaceSample(
            np.concatenate([sample.points, extra.points]),
            np.concatenate([sample.normals, extra.normals]),
            np.concatenate([sample.mesh, extra.mesh]),
        )
        drawn += more
        more = min(2 * more, LARGEST_DRAW * count)
    return sample.part(farthest_points(sample.points, count))


def visible(meshes: Sequence[Mesh], sample: SurfaceSample) -> SurfaceSample:
    """Keep the points that a ray from outside reaches; turn their normals towards where they were
    seen from.

    For each direction a ray leaves the point to the outside (the reverse of a camera's ray at it);
    a point whose every ray is stopped by the gripper itself is inside.
    """
    return _outer(RayScene(meshes), sample)


def _outer(scene: RayScene, sample: SurfaceSample) -> SurfaceSample:
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
    return SurfaceSample(sample.points, normals, sample.mesh).part(seen)


def _ballot(
    scene: RayScene,
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
    scene: RayScene,
    origin: NDArray[np.float32],
    direction: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Return which rays (K,) from `origin` (K, 3) along `direction` (K, 3) hit nothing."""
    return ~scene.blocked(np.concatenate([origin, direction], axis=1))


def sphere_directions(count: int) -> NDArray[np.float64]:
    """Return `count` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)

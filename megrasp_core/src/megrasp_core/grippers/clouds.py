"""Clouds, tokens and collision points of a gripper, all computed from its posed meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.meshes import Mesh, SurfaceSample, farthest_points, sample_stratified, thinned

from .geometry import BodyMesh, posed
from .render import render_cloud, visible

NEAR_TCP = 0.08
# A wide gripper may open beyond 8 cm: then up to 1.5 times the nearest point counts as near.
WIDE_SHARE = 1.5


@dataclass(frozen=True)
class GripperClouds:
    """Outer surface of both postures in the gripper frame, metres.

    `open_points`, `open_normals`, `closed_points`, `closed_normals`: (count, 3). `displacement`
    (count, 3) leads from each open point to the same point of the same link in the closed posture;
    `closed_displacement` is that of the closed points: from where the point was when open to where
    it is. `open_bodies` (count,): the link of each open point.
    """

    open_points: NDArray[np.float64]
    open_normals: NDArray[np.float64]
    closed_points: NDArray[np.float64]
    closed_normals: NDArray[np.float64]
    displacement: NDArray[np.float64]
    closed_displacement: NDArray[np.float64]
    open_bodies: NDArray[np.int64]


@dataclass(frozen=True)
class GripperTokens:
    """What the network sees of a gripper, in TCP coordinates: `count` open points, then `count`
    closed ones.

    `points`, `normals`, `displacement`: (2 * count, 3) in metres; `closed`: (2 * count,) float, 0
    open and 1 closed.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    closed: NDArray[np.float64]
    displacement: NDArray[np.float64]


def make_clouds(
    meshes: Sequence[BodyMesh],
    open_poses: NDArray[np.float64],
    closed_poses: NDArray[np.float64],
    count: int,
    seed: int,
) -> GripperClouds:
    """Render both postures from visual meshes; poses are gripper_from_body (nbody, 4, 4)."""
    bodies = np.array([mesh.body for mesh in meshes])
    light = thinned([one.mesh for one in meshes])
    meshes = [BodyMesh(one.body, thin) for one, thin in zip(meshes, light, strict=True)]
    first = render_cloud(posed(meshes, open_poses), count, seed)
    second = render_cloud(posed(meshes, closed_poses), count, seed)
    return GripperClouds(
        first.points,
        first.normals,
        second.points,
        second.normals,
        _moved(first, bodies, open_poses, closed_poses) - first.points,
        second.points - _moved(second, bodies, closed_poses, open_poses),
        bodies[first.mesh],
    )


def make_tokens(clouds: GripperClouds, tcp: Sequence[float], count: int) -> GripperTokens:
    """Choose farthest points, half of each posture's from within 8 cm of the TCP (where there are
    enough).
    """
    parts = []
    for closed in (False, True):
        points = (clouds.closed_points if closed else clouds.open_points) - np.asarray(tcp)
        normals = clouds.closed_normals if closed else clouds.open_normals
        moved = clouds.closed_displacement if closed else clouds.displacement
        index = _near_and_far(points, count)
        parts.append((points[index], normals[index], np.full(count, float(closed)), moved[index]))
    points, normals, flags, moved = (np.concatenate(column) for column in zip(*parts, strict=True))
    return GripperTokens(points, normals, flags, moved)


def surface_points(meshes: Sequence[Mesh], spacing: float, seed: int = 0) -> SurfaceSample:
    """Return outer surface points about `spacing` apart: dense draw, outside only, one point a
    voxel.
    """
    area = sum(mesh.area for mesh in meshes)
    drawn = max(64, int(3.0 * area / spacing**2))
    sample = visible(meshes, sample_stratified(meshes, drawn, seed))
    cells = np.floor(sample.points / spacing).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    first.sort()
    return sample.part(first)


def _moved(
    sample: SurfaceSample,
    bodies: NDArray[np.int64],
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return where points (N, 3), known with poses `before`, lie with poses `after`."""
    step = (after @ np.linalg.inv(before))[bodies[sample.mesh]]
    return np.einsum("nij,nj->ni", step[:, :3, :3], sample.points) + step[:, :3, 3]


def _near_and_far(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Choose `count` indices: half by farthest points among those near the origin, the rest among
    all others.
    """
    distance = np.linalg.norm(points, axis=1)
    near = np.flatnonzero(distance <= max(NEAR_TCP, WIDE_SHARE * float(distance.min())))
    wanted = min(count // 2, len(near))
    chosen = near[farthest_points(points[near], wanted)] if wanted else np.zeros(0, np.int64)
    rest = np.setdiff1d(np.arange(len(points)), chosen)
    return np.concatenate([chosen, rest[farthest_points(points[rest], count - wanted)]])

"""Fidelity: how far a description is from another of the same gripper, such as its CAD model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.grippers import POSTURES, Gripper
from megrasp_core.grippers.geometry import posed
from megrasp_core.grippers.render import visible
from megrasp_core.meshes import (
    Mesh,
    RayScene,
    SurfaceScene,
    sample_stratified,
    sample_uniform,
)

PAD_HALF_HEIGHT = 0.015
PAD_DEPTH = 0.010
OPENING_PATCH = 0.008


@dataclass(frozen=True)
class Comparison:
    """Differences between a gripper and a reference, metres.

    `surface`: posture -> mean symmetric point-to-surface distance of the outer surfaces;
    `surface_p95`: its 95th percentile; `tcp`: distance of the TCPs; `opening`: difference of the
    clear widths of the open postures at the TCP; `pad_motion`: largest difference of the mean
    displacement from open to closed of a finger group's pad and of the reference's surface there.
    """

    surface: dict[str, float]
    surface_p95: dict[str, float]
    tcp: float
    opening: float
    pad_motion: float


def compare(gripper: Gripper, reference: Gripper, count: int = 2000, seed: int = 0) -> Comparison:
    """Compare two grippers posture by posture in the gripper frame."""
    mean, p95 = {}, {}
    for name in POSTURES:
        own, other = gripper.meshes(name), reference.meshes(name)
        there = surface_distance(outer_points(own, count, seed), other)
        back = surface_distance(outer_points(other, count, seed), own)
        mean[name] = float(there.mean() + back.mean()) / 2.0
        p95[name] = float(np.percentile(np.concatenate([there, back]), 95))
    groups = range(min(len(gripper.description.fingers), len(reference.description.fingers)))
    motion = max(_pad_motion_difference(gripper, reference, group) for group in groups)
    tcp = float(np.linalg.norm(gripper.tcp - reference.tcp))
    return Comparison(mean, p95, tcp, opening(gripper) - opening(reference), motion)


def outer_points(meshes: Sequence[Mesh], count: int, seed: int) -> NDArray[np.float64]:
    """Return points (count, 3) of the outer surface, each part with its share of the area.

    Unlike `render_cloud` the points are not spread evenly: that costs a minute for 20 000 and
    favours edges, which biases a mean over the surface.
    """
    seen = np.zeros((0, 3))
    while len(seen) < count:
        more = visible(meshes, sample_stratified(meshes, 2 * count, seed + len(seen)))
        seen = np.concatenate([seen, more.points])
    return seen[np.random.default_rng(seed).choice(len(seen), count, replace=False)]


def surface_distance(points: NDArray[np.float64], meshes: Sequence[Mesh]) -> NDArray[np.float64]:
    """Return the distance (N,) of points (N, 3) to the nearest triangle of the meshes."""
    return SurfaceScene(meshes).distance(points)


def opening(gripper: Gripper, posture: str = "open") -> float:
    """Return the clear width between the first two finger groups around the TCP, metres; NaN where
    no ray hits both.

    Rays leave a patch of the plane through the TCP, 16 mm wide and high, along -X and +X; the
    smallest sum of the two distances to the collision geometry counts. Meant for postures whose
    fingers do not reach the middle.
    """
    poses = gripper.body_poses(posture)
    side = np.linspace(-OPENING_PATCH, OPENING_PATCH, 9)
    grid = (
        np.stack(np.meshgrid([0.0], side, side, indexing="ij"), axis=-1).reshape(-1, 3)
        + gripper.tcp
    )
    total = np.zeros(len(grid))
    for group, sign in ((0, -1.0), (1, 1.0)):
        meshes = [
            m for m in gripper.body_meshes("collision") if gripper.finger_groups[m.body] == group
        ]
        if not meshes:
            return float("nan")
        rays = np.concatenate([grid, np.tile([sign, 0.0, 0.0], (len(grid), 1))], axis=1)
        total += RayScene(posed(meshes, poses)).cast(rays).distance.astype(np.float64)
    finite = total[np.isfinite(total)]
    return float(finite.min()) if len(finite) else float("nan")


def pad_displacement(gripper: Gripper, group: int) -> NDArray[np.float64]:
    """Return the mean displacement (3,) from open to closed of a finger group's pad.

    The pad is the group's surface within 15 mm of the TCP's height and 10 mm of its innermost
    point there; that which comes nearest to the TCP where the open group is not at that height.
    """
    start, way = _group_motion(gripper, group)
    level = np.abs(start[:, 2] - gripper.tcp[2]) < PAD_HALF_HEIGHT
    if not level.any():
        return way[_nearest_to_tcp(gripper, start, way)].mean(axis=0)
    inner = np.abs(start[:, 0] - gripper.tcp[0])
    return way[level & (inner < inner[level].min() + PAD_DEPTH)].mean(axis=0)


def _pad_motion_difference(gripper: Gripper, reference: Gripper, group: int) -> float:
    """Difference (m) of the mean ways of coinciding points: those of the group that get nearest to
    the TCP, open or closed, and the points of the reference that lie nearest to them when open.
    """
    start, way = _group_motion(gripper, group)
    there, way_there = _group_motion(reference, group)
    pad = _nearest_to_tcp(gripper, start, way)
    _, nearest = KDTree(there).query(start[pad])
    return float(np.linalg.norm((way[pad] - way_there[nearest]).mean(axis=0)))


def _nearest_to_tcp(
    gripper: Gripper, start: NDArray[np.float64], way: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which points (n, 3) come within 10 mm of the least distance to the TCP, open or closed."""
    reach = np.minimum(
        np.linalg.norm(start - gripper.tcp, axis=1),
        np.linalg.norm(start + way - gripper.tcp, axis=1),
    )
    return reach < reach.min() + PAD_DEPTH


def _group_motion(
    gripper: Gripper, group: int, count: int = 4000
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) on the open surface of a finger group, `count` on each mesh, and their
    displacement (n, 3) from open to closed.
    """
    meshes = [m for m in gripper.body_meshes("visual") if gripper.finger_groups[m.body] == group]
    before, after = gripper.body_poses("open"), gripper.body_poses("closed")
    rng = np.random.default_rng(0)
    starts, ends = [], []
    for part in meshes:
        points, _ = sample_uniform(part.mesh, count, rng)
        starts.append(points @ before[part.body, :3, :3].T + before[part.body, :3, 3])
        ends.append(points @ after[part.body, :3, :3].T + after[part.body, :3, 3])
    start = np.concatenate(starts)
    return start, np.concatenate(ends) - start

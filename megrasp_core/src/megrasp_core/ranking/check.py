"""The open gripper against what was seen, what was not, and the bin, at the pre-grasp and on the
way there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from megrasp_core.ranges import COUNT, FROM_ONE, LENGTH, SHARE, check_ranges

from .observation import PointState, SceneObservation
from .probe import GripperProbe, gripper_probe

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

__all__ = [
    "REASONS",
    "CheckSettings",
    "GraspCheck",
    "angular_distance",
    "check_grasps",
    "grasp_tilt",
    "hits_on_the_way",
    "posed",
]

REASONS = (
    "workspace",
    "tilt",
    "collision",
    "unseen",
    "empty",
    "sweep",
    "object",
    "excluded",
    "score",
    "duplicate",
    "surplus",
    "unrefined",
)
"""Why a drawn grasp was not returned. `sweep`: the fingers would hit something while they close;
`object`: it grasps another object than the one asked for; `score`: less than the least score;
`surplus`: it passed, but more were found than asked for; `unrefined`: nothing coarse speaks
against it, but others promised more and went through the restarts and the whole check."""


@dataclass(frozen=True)
class CheckSettings:
    """Limits of the check.

    Attributes:
        max_inside: so many gripper points inside a seen body are tolerated at one pose: noise.
        max_structure: so many gripper points in a wall or below the floor are tolerated.
        approach_steps: poses tested between the pre-grasp and the approach pose, the latter
            included.
        max_approach_inside: as `max_inside`, along the approach.
        max_unseen: largest share of the points near the TCP that may lie where nothing was seen.
        near: points nearer to the TCP than this count for the unseen share (m).
        workspace_above: the TCP may lie so far above the region's top (m).
    """

    max_inside: int = 0
    max_structure: int = 0
    approach_steps: int = 10
    max_approach_inside: int = 0
    max_unseen: float = 0.15
    near: float = 0.06
    workspace_above: float = 0.05

    def __post_init__(self) -> None:
        check_ranges(
            self,
            max_inside=COUNT,
            max_structure=COUNT,
            approach_steps=FROM_ONE,
            max_approach_inside=COUNT,
            max_unseen=SHARE,
            near=LENGTH,
            workspace_above=LENGTH,
        )


@dataclass
class GraspCheck:
    """Outcome per grasp, arrays of length N.

    Attributes:
        reason: "" where the grasp passes, else the first reason that applies (see `REASONS`).
        collision_depth: deepest gripper point behind a seen surface within its shell at the
            pre-grasp (m); 0 where none is deeper than the margin.
        inside: number of gripper points inside seen bodies at the pre-grasp.
        approach_inside: the largest such number along the approach.
        structure: number of gripper points in walls or below the floor, pre-grasp and approach.
        unseen_share: share of the gripper points near the TCP that lie where nothing was seen
            (pre-grasp).
        hidden_share: the same over all points of the gripper: a few thousandths already foretell a
            collision.
        clearance: distance of the open gripper to the nearest seen point, wall or floor (m), at
            least 0, at most the range; 0 for grasps in collision.
        tilt: angle between gripper +Z and gravity (rad); NaN where gravity is not known.
    """

    reason: np.ndarray
    collision_depth: np.ndarray
    inside: np.ndarray
    approach_inside: np.ndarray
    structure: np.ndarray
    unseen_share: np.ndarray
    hidden_share: np.ndarray
    clearance: np.ndarray
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def passed(self) -> np.ndarray:
        """(N,) whether the grasp has no reason against it."""
        return self.reason == ""

    def reject(self, mask: np.ndarray, reason: str) -> None:
        """Note a reason for the grasps of a mask (N,) that have none yet."""
        self.reason[mask & self.passed] = reason

    def put(self, index: np.ndarray, other: GraspCheck, rows: np.ndarray) -> None:
        """Take the outcomes `rows` of another check for the grasps `index`."""
        for item in fields(self):
            getattr(self, item.name)[index] = getattr(other, item.name)[rows]


def check_grasps(
    observation: SceneObservation,
    gripper: Gripper | GripperProbe,
    world_from_gripper: np.ndarray,
    world_from_gripper_approach: np.ndarray | None = None,
    settings: CheckSettings | None = None,
    *,
    max_tilt: float | None = None,
) -> GraspCheck:
    """Check pre-grasps of an open gripper, and the straight ways to them.

    Args:
        observation: what was seen.
        gripper: a gripper, or its probe (which saves sampling it).
        world_from_gripper: (N, 4, 4) pre-grasps.
        world_from_gripper_approach: (N, 4, 4) stand-offs of the same orientation, or None:
            approach not tested.
        settings: see `CheckSettings`.
        max_tilt: largest angle between gripper +Z and gravity (rad); None or unknown gravity: no
            limit.

    Returns:
        A `GraspCheck`. Duplicates and empty grasps are found elsewhere (`rank`).
    """
    s = settings or CheckSettings()
    probe = gripper if isinstance(gripper, GripperProbe) else gripper_probe(gripper)
    poses = np.asarray(world_from_gripper, dtype=np.float64).reshape(-1, 4, 4)
    n = len(poses)
    points = posed(probe.points, poses)
    flat = points.reshape(-1, 3)
    state = observation.classify(flat).reshape(points.shape[:2])
    inside = (state == PointState.INSIDE).sum(axis=1)
    structure = (state >= PointState.WALL).sum(axis=1)
    near = np.linalg.norm(probe.points - probe.tcp, axis=1) < s.near
    if not near.any():
        near[:] = True
    approach_inside = np.zeros(n, dtype=np.int64)
    if world_from_gripper_approach is not None and n:
        way = np.asarray(world_from_gripper_approach, dtype=np.float64)[:, :3, 3] - poses[:, :3, 3]
        approach_inside, hits = hits_on_the_way(observation, probe, poses, way, s)
        structure = structure + hits
    check = GraspCheck(
        reason=np.full(n, "", dtype="<U12"),
        collision_depth=_collision_depth(observation, flat, state),
        inside=inside,
        approach_inside=approach_inside,
        structure=structure,
        unseen_share=(state[:, near] == PointState.UNSEEN).mean(axis=1).astype(np.float32),
        hidden_share=(state == PointState.UNSEEN).mean(axis=1).astype(np.float32),
        clearance=np.zeros(n, dtype=np.float32),
        tilt=grasp_tilt(poses, observation.gravity),
    )
    tcps = poses[:, :3, :3] @ probe.tcp + poses[:, :3, 3]
    check.reject(~observation.contains(tcps, above=s.workspace_above), "workspace")
    if max_tilt is not None and observation.gravity is not None:
        check.reject(check.tilt > max_tilt, "tilt")
    hit = (inside > s.max_inside) | (approach_inside > s.max_approach_inside)
    check.reject(hit | (structure > s.max_structure), "collision")
    check.reject(check.unseen_share > s.max_unseen, "unseen")
    free = np.flatnonzero(check.passed)
    check.clearance[free] = _clearance(observation, probe, poses[free], points[free])
    return check


def posed(points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Points (M, 3) at every pose (N, 4, 4): (N, M, 3) float32."""
    rotated = points.astype(np.float32) @ poses[:, :3, :3].astype(np.float32).transpose(0, 2, 1)
    return rotated + poses[:, None, :3, 3].astype(np.float32)


def grasp_tilt(poses: np.ndarray, gravity: np.ndarray | None) -> np.ndarray:
    """Angle (N,) between the +Z axis of poses (N, 4, 4) and gravity (rad); NaN where gravity is
    None.
    """
    if gravity is None:
        return np.full(len(poses), np.nan)
    return np.arccos(np.clip(poses[:, :3, 2] @ gravity, -1.0, 1.0))


def angular_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle (...) between rotation matrices (..., 3, 3) (rad)."""
    trace = np.einsum("...ij,...ij->...", a, b)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def hits_on_the_way(
    observation: SceneObservation,
    probe: GripperProbe,
    poses: np.ndarray,
    way: np.ndarray,
    settings: CheckSettings | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What a gripper meets that goes from poses (N, 4, 4) straight along `way` (N, 3) (m): the
    largest number of points inside seen bodies at one place, and the number in structure, per
    grasp (N,).
    """
    s = settings or CheckSettings()
    base = posed(probe.approach_points, poses)
    shares = np.arange(1, s.approach_steps + 1, dtype=np.float32) / s.approach_steps
    moved = base[:, None] + (shares[:, None] * way[:, None, :].astype(np.float32))[:, :, None, :]
    state = observation.classify(moved.reshape(-1, 3)).reshape(moved.shape[:3])
    inside = (state == PointState.INSIDE).sum(axis=2).max(axis=1)
    return inside, (state >= PointState.WALL).sum(axis=(1, 2))


def _collision_depth(
    observation: SceneObservation, flat: np.ndarray, state: np.ndarray
) -> np.ndarray:
    depth = np.zeros(state.size, dtype=np.float32)
    index = np.flatnonzero(state.ravel() == PointState.INSIDE)
    if len(index):
        depth[index] = observation.signed_depth(flat[index])
    return depth.reshape(state.shape).max(axis=1, initial=0.0)


def _clearance(
    observation: SceneObservation, probe: GripperProbe, poses: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Distance (n,) of the gripper at poses (n, 4, 4), points (n, M, 3), to what was seen, walls
    and floor.
    """
    result = probe.field.least(observation.surface_points.T, poses)
    structure = observation.structure_distance(points.reshape(-1, 3))
    nearest = structure.reshape(points.shape[:2]).min(axis=1, initial=np.inf)
    return np.minimum(result, nearest).astype(np.float32)

"""Of every reason against drawn poses the pose that came nearest to being a grasp."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.ranking import GripperProbe, PointState, posed, sweep_points
from megrasp_core.synthesizer import Assessment, RankingSettings, Trace, promises

__all__ = ["NearMiss", "near_misses"]

NOT_MISSED = ("", "duplicate", "surplus", "unrefined")
"""Outcomes of poses that nothing speaks against."""
SIDES = ("-x", "+x", "-y", "+y")


@dataclass(frozen=True, eq=False)
class NearMiss:
    """A pose that was not returned, in the coordinates of its `Trace`.

    Attributes:
        reason: why, see `REASONS`.
        row: of the drawn poses.
        world_from_gripper: (4, 4) where the points below are: at the pre-grasp, or on the way.
        share: of the way from open to closed at which the fingers start.
        points: (K, 3) of the gripper that speak against it; none for reasons that are not about
            places (m).
        state: (K,) what is known there, see `PointState`.
        how: what is wrong with it, with numbers.
    """

    reason: str
    row: int
    world_from_gripper: NDArray[np.float64]
    share: float
    points: NDArray[np.float64]
    state: NDArray[np.int8]
    how: str


def near_misses(trace: Trace, settings: RankingSettings, most: int = 4) -> list[NearMiss]:
    """The pose that promises most of each reason, of the most frequent reasons first.

    Args:
        trace: of a synthesis.
        settings: that it had.
        most: reasons.
    """
    if trace.assessment is None:
        return []
    reason = trace.assessment.check.reason
    counts = Counter(name for name in reason.tolist() if name not in NOT_MISSED)
    promise = promises(trace.assessment)
    found = []
    for name, _ in counts.most_common(most):
        rows = np.flatnonzero(reason == name)
        found.append(_miss(trace, settings, int(rows[promise[rows].argmax()]), name))
    return found


def _miss(trace: Trace, settings: RankingSettings, row: int, reason: str) -> NearMiss:
    assessed = trace.assessment
    assert assessed is not None
    probe = _probe(trace.probe, float(assessed.share[row]))
    pose, points, state = assessed.poses.gripper[row], np.zeros((0, 3)), np.zeros(0, np.int8)
    if reason == "collision":
        pose, points, state = _hits(trace, probe, assessed, row, settings.check.approach_steps)
    elif reason == "unseen":
        near = np.linalg.norm(probe.points - probe.tcp, axis=1) < settings.check.near
        points = posed(probe.points[near], pose[None])[0].astype(np.float64)
        state = trace.observation.classify(points)
        points, state = _only(points, state, state == PointState.UNSEEN)
    elif reason == "sweep" and assessed.contacts is not None:
        one = assessed.contacts.part(np.array([row]))
        points = sweep_points(trace.observation, probe, pose, one, settings.sweep)
        points = points.astype(np.float64)
        state = trace.observation.classify(points)
    on_the_way = not np.array_equal(pose, assessed.poses.gripper[row])
    how = _how(trace, settings, assessed, row, reason, points, state)
    if on_the_way:
        how += ", on the way there"
    return NearMiss(reason, row, pose, probe.share, points, state, how)


def _probe(probe: GripperProbe, share: float) -> GripperProbe:
    return min((probe, *probe.narrower), key=lambda one: abs(one.share - share))


def _only(
    points: NDArray[np.float64], state: NDArray[np.int8], keep: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    return points[keep], state[keep]


def _hits(
    trace: Trace, probe: GripperProbe, assessed: Assessment, row: int, steps: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """The pose at which the gripper hits, the pre-grasp or the worst place of the way there, with
    the points (K, 3) that do.
    """
    start, end = assessed.poses.gripper[row], assessed.poses.approach[row]
    worst = start, np.zeros((0, 3)), np.zeros(0, np.int8)
    for step in range(steps + 1):
        pose = start.copy()
        pose[:3, 3] += step / steps * (end - start)[:3, 3]
        local = probe.approach_points if step else probe.points
        points = posed(local, pose[None])[0].astype(np.float64)
        state = trace.observation.classify(points)
        hit = (state == PointState.INSIDE) | (state >= PointState.WALL)
        if hit.sum() > len(worst[1]):
            worst = (pose, *_only(points, state, hit))
        if not step and len(worst[1]):
            break
    return worst


def _how(
    trace: Trace,
    settings: RankingSettings,
    assessed: Assessment,
    row: int,
    reason: str,
    points: NDArray[np.float64],
    state: NDArray[np.int8],
) -> str:
    check, request = assessed.check, trace.request
    if reason in ("collision", "sweep"):
        return _where(trace, points, state)
    if reason == "unseen":
        return (
            f"{100 * check.unseen_share[row]:.0f} % of the gripper near the TCP lie where nothing "
            f"was seen, {100 * settings.check.max_unseen:.0f} % are tolerated"
        )
    if reason == "tilt":
        return f"tilted by {check.tilt[row]:.2f} rad, max_tilt is {request.max_tilt:.2f}"
    if reason == "score":
        return f"score {assessed.score[row]:.2f}, min_score is {request.min_score:g}"
    if reason == "empty" and assessed.contacts is not None:
        return (
            f"{int(assessed.contacts.count[row])} seen points between the fingers, "
            f"{settings.contact.min_points} are needed"
        )
    if reason == "object":
        return f"takes object {int(assessed.object[row])}, target is {request.target}"
    if reason == "workspace":
        place = trace.observation.box_coordinates(assessed.poses.tcp[row, :3, 3][None])[0]
        over = np.maximum(np.abs(place) - trace.observation.half, 0.0)
        return f"the TCP is {1000 * float(np.linalg.norm(over)):.0f} mm outside the region"
    return "as near to a pose that failed before as exclude_radius says"


def _where(trace: Trace, points: NDArray[np.float64], state: NDArray[np.int8]) -> str:
    """Which of the points are where, and how deep."""
    seen, parts = trace.observation, []
    inside, floor, wall = (
        points[state == one] for one in (PointState.INSIDE, PointState.FLOOR, PointState.WALL)
    )
    if len(wall):
        place, half = seen.box_coordinates(wall), seen.half
        beyond = np.stack(
            [-place[:, 0] - half[0], place[:, 0] - half[0],
             -place[:, 1] - half[1], place[:, 1] - half[1]], axis=1,
        )  # fmt: skip
        face = beyond.argmax(axis=1)
        for side in np.unique(face):
            deep = _mm(beyond[face == side, side])
            parts.append(f"{(face == side).sum()} points in the {SIDES[side]} wall, {deep}")
    if len(floor):
        parts.append(f"{len(floor)} points below the floor, {_mm(-seen.floor_height(floor))}")
    if len(inside):
        parts.append(f"{len(inside)} points in objects, {_mm(seen.signed_depth(inside))}")
    return "; ".join(parts) or "it hits what a coarser look at the gripper met"


def _mm(depth: NDArray[np.float64]) -> str:
    return f"{1000 * float(depth.max()):.0f} mm deep"

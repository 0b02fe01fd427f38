"""The part of the drives' ranges in which jaws close: models may turn much farther than that."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .fingers import Finger, crossed_over, joint_axes
from .mechanism import Mechanism, palm_centre
from .motion import DriveMotion
from .solids import Solids

WIDE = 1.75
"""Fingers that turn by more than this (rad) over their range get the range searched."""

LOOKING = 1.0
"""Pads look at each other while they have turned by no more than this (rad) from where they
meet: they must still meet a line along the closing axis well within its cone of friction."""

SLACK = 0.35
"""The tips' nearest posture may lie this far (rad) behind the one in which the pads meet."""

STEP = 0.002
FEWEST, MOST = 60, 400
TURN_SAMPLES = 24
OUTER = 0.6
"""What lies beyond this share of a finger's length from its joint must keep out of the palm."""

BLOCKED = 0.1
"""Share of a finger's outer points inside the palm from which on the posture is impossible."""

REST_COST = 0.02


def closing_window(
    mechanism: Mechanism, motion: DriveMotion, fingers: Sequence[Finger]
) -> DriveMotion:
    """Return the motion limited to the stroke in which the fingertips come together, unlimited
    where no finger turns far. Closed loops limit themselves.
    """
    drives = sorted({drive for finger in fingers for drive in finger.curl})
    turn = max((_turn(motion, finger, drives) for finger in fingers), default=0.0)
    if motion.simulated or turn < WIDE:
        return motion
    count = int(np.clip(turn * mechanism.branches[0].reach / STEP, FEWEST, MOST))
    strokes: list[_Stroke] = []
    for signs in itertools.product((True, False), repeat=len(drives) - 1):
        up = np.array((True, *signs))
        start, end = motion.rest(), motion.rest()
        start[drives] = np.where(up, motion.low[drives], motion.high[drives])
        end[drives] = np.where(up, motion.high[drives], motion.low[drives])
        path = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
        strokes += _strokes(mechanism, motion, fingers, path)
    free = [stroke for stroke in strokes if not stroke.blocked] or strokes
    if not free:
        return motion
    best = max(free, key=lambda stroke: stroke.score)
    low, high = motion.low, motion.high
    low[drives] = np.minimum(best.open, best.closed)[drives]
    high[drives] = np.maximum(best.open, best.closed)[drives]
    return motion.within(low, high)


def looking_from(
    motion: DriveMotion,
    fingers: Sequence[Finger],
    start: NDArray[np.float64],
    closed: NDArray[np.float64],
    axis: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the lengths (n,) farthest towards `start` at which the pads, which meet along the
    unit `axis` (3,) at `closed`, still look at each other.
    """
    met = [motion.poses(closed)[f.tip_body, :3, :3].T @ axis for f in fingers]

    def looks(time: float) -> bool:
        poses = motion.poses(closed + time * (start - closed))
        now = [
            float(poses[f.tip_body, :3, :3] @ n @ axis) for f, n in zip(fingers, met, strict=True)
        ]
        return min(now) >= np.cos(LOOKING)

    if looks(1.0):
        return start
    times = np.linspace(0.0, 1.0, FEWEST)
    first = next(index for index, time in enumerate(times) if not looks(float(time)))
    low, high = float(times[first - 1]), float(times[first])
    for _ in range(10):
        half = (low + high) / 2.0
        low, high = (half, high) if looks(half) else (low, half)
    return closed + low * (start - closed)


@dataclass(frozen=True)
class _Stroke:
    """Lengths (n,) of all drives where the tips are nearest and as far apart as they look at each
    other; `score` to compare; whether the palm is in the way at the closed end, or fingers have
    crossed over at the open one.
    """

    open: NDArray[np.float64]
    closed: NDArray[np.float64]
    score: float
    blocked: bool


def _turn(motion: DriveMotion, finger: Finger, drives: Sequence[int]) -> float:
    """Return by how much (rad) a fingertip turns over the whole range of the drives."""
    lengths = np.linspace(0.0, 1.0, TURN_SAMPLES)[:, None]
    path = motion.rest() + np.zeros((TURN_SAMPLES, 1))
    path[:, drives] = (motion.low + lengths * (motion.high - motion.low))[:, drives]
    if motion.simulated:
        return 0.0
    turns = [motion.poses(row)[finger.tip_body, :3, :3] for row in path]
    return sum(
        float(Rotation.from_matrix(b @ a.T).magnitude()) for a, b in itertools.pairwise(turns)
    )


def _strokes(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: Sequence[Finger],
    path: NDArray[np.float64],
) -> list[_Stroke]:
    """Return the strokes along a path (N, n) of lengths."""
    palm = Solids(mechanism.model, mechanism.palm)
    poses = [motion.poses(lengths) for lengths in path]
    tips = np.array([[finger.tip_at(pose) for finger in fingers] for pose in poses])
    turns = np.array([[pose[f.tip_body, :3, :3] for f in fingers] for pose in poses])
    pairs = list(itertools.combinations(range(len(fingers)), 2))
    apart = np.mean([np.linalg.norm(tips[:, a] - tips[:, b], axis=1) for a, b in pairs], axis=0)
    outer = [_outer(mechanism, motion, finger) for finger in fingers]
    blocked = [
        max(palm.share_inside(_at(pose, f, points), pose) for f, points in zip(fingers, outer))
        > BLOCKED
        for pose in poses
    ]
    out = []
    for event in _minima(apart):
        middle = palm_centre(mechanism, poses[event])
        ahead = float(np.linalg.norm(tips[event].mean(axis=0) - middle))
        for way in (-1, 1):
            last = event
            while 0 <= last + way < len(path):
                following = last + way
                turned = _angle(turns[event], turns[following])
                if apart[following] <= apart[last] or turned > LOOKING + SLACK:
                    break
                if blocked[following] and not blocked[event]:
                    break
                last = following
            if last == event:
                continue
            crossed = crossed_over(fingers, motion, path[last])
            moved = tips[event] - tips[event + way]
            speed = float(np.linalg.norm(moved, axis=1).mean())
            opposed = 1.0 - float(np.linalg.norm(moved.mean(axis=0))) / max(speed, 1e-9)
            rest = float(np.abs(path[event]).mean())
            score = float(apart[last] - apart[event]) * opposed * ahead / (1.0 + REST_COST * rest)
            out.append(_Stroke(path[last], path[event], score, blocked[event] or crossed))
    return out


def _minima(values: NDArray[np.float64]) -> list[int]:
    padded = np.concatenate([[np.inf], values, [np.inf]])
    return np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])).tolist()


def _angle(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    """Return the largest angle (rad) between two sets of rotations (F, 3, 3)."""
    relative = after @ np.swapaxes(before, 1, 2)
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())


def _outer(mechanism: Mechanism, motion: DriveMotion, finger: Finger) -> NDArray[np.float64]:
    """Return the outer points (N, 3) of a finger's last link in the frame of its first body."""
    lengths = motion.rest()
    poses = motion.poses(lengths)
    points = mechanism.surface(poses, finger.tip)
    if not finger.sliding:
        anchor = joint_axes(motion, lengths)[0][finger.moving[-1]]
        far = np.linalg.norm(points - anchor, axis=1)
        points = points[far >= OUTER * far.max()]
    pose = poses[finger.tip_body]
    return (points - pose[:3, 3]) @ pose[:3, :3]


def _at(
    poses: NDArray[np.float64], finger: Finger, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    pose = poses[finger.tip_body]
    return points @ pose[:3, :3].T + pose[:3, 3]

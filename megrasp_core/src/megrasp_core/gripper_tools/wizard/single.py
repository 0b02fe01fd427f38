"""A single moving jaw that closes against a fixed one, a part of the palm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import NO_SUCTION

from .fingers import BESIDE, Finger, joint_axes, leads_aside
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition
from .profile import CELL, across, room_ahead
from .solids import Solids

OUTER = 0.65
"""The jaw meets the fixed one with what lies beyond this share of its length from its joint; at
its root it always touches."""

TOUCH = 0.004
STEP = 0.002
FEWEST, MOST = 30, 400
INSIDE = 0.3
"""With this share of its outer points in the palm a jaw is where no real one gets."""

FLAT = 0.003
"""Room between pads that meet differs by less than this (m)."""

FACE_RANGE = 0.008
"""The fixed face is looked at where the jaw is at most this much (m) farther from it than at its
nearest point."""

BACK = 0.1
"""Share of the way by which a turning jaw is opened to look at what it meets."""

MOST_TURN = np.radians(30.0)
FEWEST_CELLS = 8
SHARE = 0.25
"""A face ahead of a sliding jaw stops it when it has this share of the largest one's area."""

LEAST_PADS = 4e-5
"""Area (m2) of pads that face each other, two fingertips wide."""


@dataclass(frozen=True)
class _Close:
    """A way to close: lengths (n,) open and closed, unit `axis` (3,) from the jaw to the fixed
    pad, `meet` (3,) in the middle of that, `area` (m2) that faces it, `stroke` (m) of the jaw.
    """

    open: NDArray[np.float64]
    closed: NDArray[np.float64]
    axis: NDArray[np.float64]
    meet: NDArray[np.float64]
    area: float
    stroke: float


def oppose_single(
    mechanism: Mechanism,
    motion: DriveMotion,
    finger: Finger,
    ends: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Opposition:
    """Return the opposition of one finger and the palm.

    The jaw is moved through its whole range. Between two postures in which its end meets the palm
    or a limit it is free; of all these ends it closes at the one where most of it faces the palm.

    Args:
        mechanism: its structure.
        motion: its joints.
        finger: the jaw.
        ends: lengths (n,) of the open and the closed posture where they are given.

    Raises:
        DescriptionError: the finger has several drives, or comes nowhere near the palm.
    """
    if len(finger.curl) != 1:
        raise DescriptionError(
            f"the only finger, '{finger.name}', has {len(finger.curl)} drives; expected two "
            "fingers, or one that one drive closes against the palm. Name the link that the "
            "fingers hang from: --root LINK"
        )
    sweep = _Sweep(mechanism, motion, finger)
    ways = [sweep.given(*ends)] if ends is not None else sweep.ways()
    if not ways:
        raise DescriptionError(
            f"the only finger, '{finger.name}', does not close against the palm: {NO_SUCTION}. "
            "Where both jaws hang from another link, name it: --root LINK"
        )
    best = max(ways, key=lambda way: way.area * way.stroke)
    _refuse_cups(sweep, finger, best)
    palm = tuple(int(b) for b in mechanism.palm if (mechanism.owner == b).any())
    return Opposition(
        ((finger,), ()),
        best.open,
        best.closed,
        best.axis,
        best.meet - best.stroke / 2.0 * best.axis,
        1.0,
        1.0,
        False,
        fixed=((), palm),
        meet=best.meet,
    )


def _refuse_cups(sweep: _Sweep, finger: Finger, way: _Close) -> None:
    """Refuse a part that only moves in and out of its base, which nothing gets between."""
    if finger.sliding and sweep.outward(way) < BESIDE:
        raise DescriptionError(
            f"the only moving link, '{finger.name}', moves in and out of the base: {NO_SUCTION}. "
            "Where both jaws hang from another link, name it: --root LINK"
        )


class _Sweep:
    """The jaw moved from one end of its range to the other."""

    def __init__(self, mechanism: Mechanism, motion: DriveMotion, finger: Finger) -> None:
        self._mechanism, self._motion, self._finger = mechanism, motion, finger
        self._drive = finger.curl[0]
        self._palm = Solids(mechanism.model, mechanism.palm)
        low, high = motion.low[self._drive], motion.high[self._drive]
        if not finger.sliding:
            travel = abs(high - low) * mechanism.branches[0].reach
        else:
            travel = abs(high - low)
        count = int(np.clip(travel / STEP, FEWEST, MOST))
        self._path = np.tile(motion.rest(), (count, 1))
        self._path[:, self._drive] = np.linspace(low, high, count)

    def ways(self) -> list[_Close]:
        """Return the ways to close."""
        return self._slides() if self._finger.sliding else self._turns()

    def outward(self, way: _Close) -> float:
        """Return the share of a jaw's way from its root to its tip that is not along the closing
        axis.
        """
        poses = self._motion.poses(way.open)
        return leads_aside(self._mechanism, poses, self._finger, way.axis)

    def _slides(self) -> list[_Close]:
        """Return how the jaw meets what lies ahead of it, in either sense."""
        out = []
        for start, end in ((self._path[0], self._path[-1]), (self._path[-1], self._path[0])):
            way = self._ahead(start, end)
            if way is not None:
                out.append(way)
        return out

    def _ahead(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> _Close | None:
        """Return where the sliding jaw meets the nearest face of the palm of some size."""
        poses = self._motion.poses(start)
        way = self._finger.tip_at(self._motion.poses(end)) - self._finger.tip_at(poses)
        travel = float(np.linalg.norm(way))
        if travel < TOUCH:
            return None
        axis = way / travel
        jaw = self._mechanism.surface(poses, self._finger.tip)
        palm = self._mechanism.surface(poses, self._mechanism.palm)
        room, cells, front = room_ahead(jaw, palm, axis)
        beyond = room > TOUCH
        levels = np.round(room[beyond] / FLAT).astype(int)
        if not len(levels):
            return None
        values, counts = np.unique(levels, return_counts=True)
        # A face on the border of two levels counts in both.
        counts = np.array([counts[np.abs(values - value) <= 1].sum() for value in values])
        large = values[counts >= max(SHARE * counts.max(), LEAST_PADS / CELL**2)]
        if not len(large):
            return None
        met = beyond & (np.abs(room - large.min() * FLAT) <= 1.5 * FLAT)
        depth = float(np.median(room[met]))
        if depth > travel + 0.5 * travel:
            return None
        meet = cells[met].mean(axis=0) + (float(np.median(front[met])) + depth) * axis
        share = min(depth / travel, 1.0)
        closed = start + share * (end - start)
        return _Close(start, closed, axis, meet, float(met.sum()) * CELL**2, share * travel)

    def _turns(self) -> list[_Close]:
        """Return the ways to close at either end of every free stretch of the range."""
        rooms = np.array([self._room(lengths)[0] for lengths in self._path])
        if not np.isfinite(rooms).all():
            return []
        free = np.flatnonzero(rooms > TOUCH)
        out = []
        for run in np.split(free, np.flatnonzero(np.diff(free) > 1) + 1):
            if len(run) < 2:
                continue
            if self._inside(self._path[run[len(run) // 2]]) > INSIDE:
                continue
            for end, other in ((run[0], run[-1]), (run[-1], run[0])):
                outward = -1 if end == run[0] else 1
                meets = 0 <= end + outward < len(rooms)
                widest = float(rooms[run].max())
                if not meets and rooms[end] > 0.5 * widest:
                    continue
                closed = end
                while 0 <= closed + outward < len(rooms) and (
                    closed == end or rooms[closed + outward] < rooms[closed]
                ):
                    closed += outward
                way = self._close(self._path[other], self._path[closed])
                if way is not None and way.area >= LEAST_PADS:
                    out.append(way)
        return out

    def given(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> _Close:
        """Return the way to close between given lengths (n,)."""
        way = self._ahead(start, end) if self._finger.sliding else self._close(start, end)
        if way is None:
            raise DescriptionError(
                f"--open and --closed move the only finger, '{self._finger.name}', away from the "
                "palm; expected it to close against the palm: change the two"
            )
        return replace(way, open=start, closed=end)

    def _close(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> _Close | None:
        """Return how the turning jaw meets the palm at `end`, None where nothing of it faces the
        palm.
        """
        before = end + BACK * (start - end)
        poses = self._motion.poses(before)
        jaw = self._outer(before, poses)
        palm = self._mechanism.surface(poses, self._mechanism.palm)
        _, own, _ = self._room(before)
        axis = self._velocity(start, before, own)
        if axis is None:
            return None
        for last in (False, True):
            room, cells, front = room_ahead(jaw, palm, axis)
            if not len(room):
                return None
            near = room <= float(np.quantile(room, 0.05)) + FACE_RANGE
            if last:
                break
            axis = _face_normal(cells[near], (front + room)[near], axis)
        meet = cells[near].mean(axis=0) + float(np.median((front + room)[near])) * axis
        moved = self._finger.tip_at(poses) - self._finger.tip_at(self._motion.poses(start))
        area = float(near.sum()) * CELL**2
        return _Close(start, end, axis, meet, area, float(np.linalg.norm(moved)))

    def _velocity(
        self, start: NDArray[np.float64], end: NDArray[np.float64], own: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the unit direction (3,) in which the jaw's point `own` moves as it closes."""
        before = end + 1e-3 * (start - end)
        pose, earlier = self._motion.poses(end), self._motion.poses(before)
        body = self._finger.tip_body
        local = pose[body, :3, :3].T @ (own - pose[body, :3, 3])
        moved = own - (earlier[body, :3, :3] @ local + earlier[body, :3, 3])
        size = float(np.linalg.norm(moved))
        return moved / size if size > 1e-9 else None

    def _inside(self, lengths: NDArray[np.float64]) -> float:
        poses = self._motion.poses(lengths)
        return self._palm.share_inside(self._outer(lengths, poses), poses)

    def _outer(
        self, lengths: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        points = self._mechanism.surface(poses, self._finger.tip)
        if self._finger.sliding:
            return points
        anchor = joint_axes(self._motion, lengths)[0][self._finger.moving[-1]]
        reach = np.linalg.norm(points - anchor, axis=1)
        return points[reach >= OUTER * reach.max()]

    def _room(
        self, lengths: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Return the distance (m) from the jaw's end to the palm, and the nearest points (3,) of
        jaw and palm, model frame.
        """
        poses = self._motion.poses(lengths)
        points = self._outer(lengths, poses)
        palm = self._mechanism.surface(poses, self._mechanism.palm)
        if not len(palm):
            return float("inf"), np.zeros(3), np.zeros(3)
        distance, index = KDTree(palm).query(points)
        nearest = int(np.argmin(distance))
        other = palm[np.asarray(index)[nearest]]
        return float(np.asarray(distance)[nearest]), points[nearest], other


def _face_normal(
    cells: NDArray[np.float64], depth: NDArray[np.float64], axis: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the unit normal of a face near to `axis` (3,), or that where it is not flat.

    Args:
        cells: places (N, 3) across the axis.
        depth: where the face lies along it (N,).
        axis: unit vector (3,).
    """
    basis = across(axis)
    columns = np.column_stack([cells @ basis.T, np.ones(len(cells))])
    kept = np.abs(depth - np.median(depth)) <= 2.0 * FACE_RANGE
    slope = np.zeros(3)
    for limit in (2.0 * FLAT, FLAT, FLAT / 2.0):
        if kept.sum() < FEWEST_CELLS:
            return axis
        slope = np.linalg.lstsq(columns[kept], depth[kept], rcond=None)[0]
        kept = np.abs(columns @ slope - depth) <= limit
    normal = axis - slope[:2] @ basis
    normal = normal / np.linalg.norm(normal)
    flat = kept.sum() >= max(FEWEST_CELLS, len(cells) / 2)
    return normal if flat and float(normal @ axis) >= np.cos(MOST_TURN) else axis

"""Tool centre point: between the pads, a little nearer to the tips than the pads' middle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from .axes import Axes
from .fingers import joint_axes
from .gaps import Gaps, first_contact
from .lean import leans
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition
from .pads import Pad, find_pad
from .profile import Profile, pad_profile

BEHIND_TIP = 0.42
"""Share of the pads' length from the tips to the TCP: the value that agrees best with the stated
TCPs of real jaws, between holding with the tips and with the pads' middle."""

MOST_BEHIND = 0.03
"""Farthest (m) behind the tips, however long the faces: in a bin, tips reach and palms do not."""

WEAK = 1e-3
"""Weight of the room's middle against the lines of motion."""

PARALLEL = np.radians(15.0)
"""Pads that turn by less than this from open to closed are kept parallel by a linkage."""

CLOSED_SHARE = 0.5
"""Where between open and closed turning fingers hold what they hold, as a share of the way."""

REACHED = 0.004
"""Open jaws reach so far (m) past the TCP at least."""

LINKAGE_JOINTS = 2

MEETING = 0.006
"""The face of a fixed jaw begins so far (m) before the point where the moving one meets it."""

TIP_MISSING = 0.012
"""Faces that end farther (m) behind the tips than this are no pads."""

ON_AXIS = 0.0015
"""An offset (m) from the model's own middle this small is drawing and sampling error."""


@dataclass(frozen=True)
class PadFinder:
    """Pads of a jaw gripper in any posture; `length` (m) once it is known from the open one."""

    mechanism: Mechanism
    motion: DriveMotion
    opposition: Opposition
    axes: Axes

    def pad(self, lengths: NDArray[np.float64], length: float | None = None) -> Pad | None:
        """Return the pads for driven lengths (n,), None where no faces are opposite."""
        poses = self.motion.poses(lengths)
        turning = not (self._sliding() or stays_parallel(self.motion, self.opposition))
        return self._between(self._side(poses, 0), self._side(poses, 1), turning, length)

    def upright(self) -> Upright | None:
        """Return the pads with every turning finger of the open posture turned back until its
        faces look along the closing axis; None where no faces are opposite then, or look in no
        clear direction.
        """
        opened, closed = self.opposition.open, self.opposition.closed
        poses = self.motion.poses(opened)
        anchors = joint_axes(self.motion, opened)[0]
        across = np.cross(self.axes.approach, self.axes.closing)
        back: dict[str, NDArray[np.float64]] = {}
        sides = []
        for side, group in enumerate(self.opposition.groups):
            points = []
            for finger in group:
                angle = leans(self.mechanism, self.motion, finger, self.axes, closed, opened)
                if angle is None:
                    return None
                turn = Rotation.from_rotvec(-angle * across).as_matrix()
                anchor = anchors[finger.moving[-1]]
                pose = np.eye(4)
                pose[:3, :3], pose[:3, 3] = turn, anchor - turn @ anchor
                back[finger.name] = pose
                own = self.mechanism.surface(poses, finger.tip)
                points.append(own @ turn.T + pose[:3, 3])
            sides.append(np.concatenate(points) if points else self._side(poses, side))
        pad = self._between(sides[0], sides[1], turning=False, length=None)
        return None if pad is None else Upright(pad, back)

    def closed(self, opened: Pad | None) -> tuple[NDArray[np.float64], bool]:
        """Return the lengths (n,) at which the pads first meet on the way to the closed posture,
        and whether they do; without pads, when the last links do.
        """
        start, end = self.opposition.open, self.opposition.closed
        gaps = Gaps(self.mechanism.model)

        def gap(time: float) -> float:
            lengths = start + time * (end - start)
            pad = None if opened is None else self.pad(lengths, opened.length)
            if pad is not None and opened is not None and opened.opposite:
                return pad.room
            ends = self.opposition.tips(0), self.opposition.tips(1)
            return gaps.distance(self.motion.qpos(lengths), *ends)

        time, contact = first_contact(gap)
        return start + time * (end - start), contact

    def _sliding(self) -> bool:
        return all(f.sliding for group in self.opposition.groups for f in group)

    def _side(self, poses: NDArray[np.float64], side: int) -> NDArray[np.float64]:
        """Return the surface points (N, 3) of the last links of one side; of a fixed one only
        what lies where the jaw meets it or beyond.
        """
        points = self.mechanism.surface(poses, self.opposition.tips(side))
        if self.opposition.groups[side] or self.opposition.meet is None:
            return points
        outward = self.axes.closing if side else -self.axes.closing
        return points[(points - self.opposition.meet) @ outward > -MEETING]

    def _between(
        self,
        first: NDArray[np.float64],
        second: NDArray[np.float64],
        turning: bool,
        length: float | None,
    ) -> Pad | None:
        closing = self.axes.closing
        basis = np.stack([self.axes.approach, np.cross(closing, self.axes.approach)])
        profile = pad_profile(first, second, closing, basis)
        pad = find_pad(profile, closing, turning, length)
        if pad is not None and _reaches_tip(profile):
            return pad
        beside = pad_profile(first, second, closing, basis, sideways=False)
        pad = find_pad(beside, closing, turning, length)
        return None if pad is None else replace(pad, opposite=False)


class FoundGroups(Protocol):
    """What an analysis holds of groups and axes."""

    @property
    def opposition(self) -> Opposition:
        """The groups."""
        ...

    @property
    def axes(self) -> Axes:
        """The axes."""
        ...


@dataclass(frozen=True)
class Upright:
    """Pads of fingers turned upright, and finger's name -> the motion (4, 4) that turned it from
    the open posture, model frame.
    """

    pad: Pad
    turned: dict[str, NDArray[np.float64]]


def find_tcp(
    finder: PadFinder,
    pads: tuple[Pad | None, Pad | None],
    depth: float | None,
) -> NDArray[np.float64]:
    """Return the TCP (3,) in the model frame.

    Jaws: in the middle of the open pads' room, behind the tips. Pads on arcs, about one hinge or
    kept parallel by a linkage, move along the approach as they close, so the TCP lies half-way
    between where they are open and closed; fingers of several joints curl beyond that when they
    close on nothing. Hands, and jaws whose faces are not opposite: where the pads meet.

    Args:
        finder: finds the pads; holds joints, groups and axes.
        pads: pads of the open and the closed posture, None for hands.
        depth: distance of the TCP behind the open tips (m), None for the rule.
    """
    motion, opposition, axes = finder.motion, finder.opposition, finder.axes
    opened, closed = pads
    if opened is None:
        return _on_axis(opposition.middle, axes)
    behind = min(BEHIND_TIP * opened.length, MOST_BEHIND) if depth is None else depth
    level = opened.tip - behind
    if depth is None:
        if stays_parallel(motion, opposition):
            if closed is not None:
                level += (closed.tip - opened.tip) / 2.0
        elif all(len(f.moving) == 1 for group in opposition.groups for f in group):
            turned = _turning_level(finder, level)
            # Two open jaws must reach the TCP; with a single one the fixed one does.
            if turned <= opened.tip - REACHED or not all(opposition.groups):
                level = turned
    middle = opened.middle if opened.opposite else _centre(motion, opposition, axes, opened)
    beside = middle - (middle @ axes.approach) * axes.approach
    return _on_axis(beside + level * axes.approach, axes)


def other_tcps(
    mechanism: Mechanism, motion: DriveMotion, found: FoundGroups
) -> list[tuple[str, NDArray[np.float64]]]:
    """Return further TCPs (3,) in the model frame with how they were found, the likeliest first:
    for hands and tips that pass beside each other.
    """
    opposition, axes = found.opposition, found.axes
    out = []
    for name, lengths in (("closed", opposition.closed), ("open", opposition.open)):
        poses = motion.poses(lengths)
        sides = [mechanism.surface(poses, opposition.tips(side)) for side in (0, 1)]
        distance, index = KDTree(sides[1]).query(sides[0])
        nearest = int(np.argmin(distance))
        between = (sides[0][nearest] + sides[1][np.asarray(index)[nearest]]) / 2.0
        out.append((f"half-way between the {name} fingertips where they are nearest", between))
        tips = [
            np.mean([finger.tip_at(poses) for finger in group], axis=0)
            if group
            else sides[side].mean(axis=0)
            for side, group in enumerate(opposition.groups)
        ]
        out.append((f"in the middle of the {name} fingertips", (tips[0] + tips[1]) / 2.0))
    return [(rule, _on_axis(point, axes)) for rule, point in out]


def _turning_level(finder: PadFinder, otherwise: float) -> float:
    """Return the mean height (m) along the approach of the point behind the tips of every finger,
    over both sides and both postures.
    """
    upright = finder.upright()
    if upright is None:
        return otherwise
    motion, opposition, axes = finder.motion, finder.opposition, finder.axes
    pad = upright.pad
    level = pad.tip - min(BEHIND_TIP * pad.length, MOST_BEHIND)
    before, after = motion.poses(opposition.open), motion.poses(opposition.closed)
    sides = []
    for side, group in enumerate(opposition.groups):
        inner = (pad.middle @ axes.closing) + (side - 0.5) * pad.room
        heights = [] if group else [level]
        for finger in group:
            tip = finger.tip_at(before)
            turn = upright.turned[finger.name]
            place = turn[:3, :3] @ tip + turn[:3, 3]
            if pad.opposite:
                place = place + (inner - place @ axes.closing) * axes.closing
            place = place + (level - place @ axes.approach) * axes.approach
            opened = turn[:3, :3].T @ (place - turn[:3, 3])
            pose, later = before[finger.tip_body], after[finger.tip_body]
            local = pose[:3, :3].T @ (opened - pose[:3, 3])
            shut = later[:3, :3] @ local + later[:3, 3]
            held = opened + CLOSED_SHARE * (shut - opened)
            heights.append(float(held @ axes.approach))
        sides.append(float(np.mean(heights)))
    return float(np.mean(sides))


def _reaches_tip(profile: Profile) -> bool:
    """Whether what is opposite reaches the tips: feet of fingers that pass beside each other may
    be opposite too.
    """
    return bool(profile.end - float(profile.cells[:, 0].max()) < TIP_MISSING)


def _centre(
    motion: DriveMotion, opposition: Opposition, axes: Axes, pad: Pad
) -> NDArray[np.float64]:
    """Return the point (3,) that the fingertips close towards, seen along the approach.

    It is the one nearest to the lines of the tips' motion; where these are parallel, the middle of
    the room.
    """
    before, after = motion.poses(opposition.open), motion.poses(opposition.closed)
    flat = np.eye(3) - np.outer(axes.approach, axes.approach)
    left, right = WEAK * np.eye(3), WEAK * pad.middle
    for finger in [finger for group in opposition.groups for finger in group]:
        start = flat @ finger.tip_at(before)
        way = flat @ finger.tip_at(after) - start
        way = way / max(float(np.linalg.norm(way)), 1e-9)
        off = np.eye(3) - np.outer(way, way)
        left, right = left + off, right + off @ start
    return np.linalg.solve(left, right).astype(np.float64)


def stays_parallel(motion: DriveMotion, opposition: Opposition) -> bool:
    before, after = motion.poses(opposition.open), motion.poses(opposition.closed)
    fingers = [finger for group in opposition.groups for finger in group]
    turns = [
        Rotation.from_matrix(after[f.tip_body, :3, :3] @ before[f.tip_body, :3, :3].T).magnitude()
        for f in fingers
    ]
    # Fingers of many joints that end as they began have curled in between.
    linkage = max(len(finger.moving) for finger in fingers) <= LINKAGE_JOINTS
    return linkage and max(turns) < PARALLEL


def _on_axis(point: NDArray[np.float64], axes: Axes) -> NDArray[np.float64]:
    """Return the point with small offsets across the approach axis removed."""
    local = axes.rotation() @ point
    local[:2] = np.where(np.abs(local[:2]) < ON_AXIS, 0.0, local[:2])
    return axes.rotation().T @ local

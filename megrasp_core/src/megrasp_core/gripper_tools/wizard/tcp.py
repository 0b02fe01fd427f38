"""Tool centre point: between the pads, a little nearer to the tips than the pads' middle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .axes import Axes
from .gaps import Gaps, first_contact
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition
from .pads import Pad, find_pad
from .profile import pad_profile

BEHIND_TIP = 0.42
"""Share of the pads' length from the tips to the TCP: the value that agrees best with the stated
TCPs of real jaws, between holding with the tips and with the pads' middle."""

MOST_BEHIND = 0.03
"""Farthest (m) behind the tips, however long the faces: in a bin, tips reach and palms do not."""

WEAK = 1e-3
"""Weight of the room's middle against the lines of motion."""

PARALLEL = np.radians(15.0)
"""Pads that turn by less than this from open to closed are kept parallel by a linkage."""

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
        turning = not all(f.sliding for group in self.opposition.groups for f in group)
        across = np.cross(self.axes.closing, self.axes.approach)
        basis = np.stack([self.axes.approach, across])
        poses = self.motion.poses(lengths)
        first, second = (
            self.mechanism.surface(poses, self.opposition.tips(side)) for side in (0, 1)
        )
        closing = self.axes.closing
        pad = find_pad(pad_profile(first, second, closing, basis), closing, turning, length)
        if pad is not None:
            return pad
        beside = pad_profile(first, second, closing, basis, sideways=False)
        pad = find_pad(beside, closing, turning, length)
        return None if pad is None else replace(pad, opposite=False)

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


def find_tcp(
    motion: DriveMotion,
    opposition: Opposition,
    axes: Axes,
    pads: tuple[Pad | None, Pad | None],
    depth: float | None,
) -> NDArray[np.float64]:
    """Return the TCP (3,) in the model frame.

    Jaws: in the middle of the open pads' room, behind the tips. Pads that a linkage keeps parallel
    move forward as they close, so theirs lies half-way. Hands, and jaws whose faces are not
    opposite: where the pads meet.

    Args:
        motion: the gripper's joints.
        opposition: the groups.
        axes: the gripper's axes.
        pads: pads of the open and the closed posture, None for hands.
        depth: distance of the TCP behind the tips (m), None for the rule.
    """
    opened, closed = pads
    if opened is None:
        return _on_axis(opposition.middle, axes)
    behind = min(BEHIND_TIP * opened.length, MOST_BEHIND) if depth is None else depth
    level = opened.tip - behind
    if closed is not None and _stays_parallel(motion, opposition):
        level += (closed.tip - opened.tip) / 2.0
    middle = opened.middle if opened.opposite else _centre(motion, opposition, axes, opened)
    beside = middle - (middle @ axes.approach) * axes.approach
    return _on_axis(beside + level * axes.approach, axes)


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


def _stays_parallel(motion: DriveMotion, opposition: Opposition) -> bool:
    before, after = motion.poses(opposition.open), motion.poses(opposition.closed)
    fingers = [finger for group in opposition.groups for finger in group]
    turns = [
        Rotation.from_matrix(after[f.tip_body, :3, :3] @ before[f.tip_body, :3, :3].T).magnitude()
        for f in fingers
    ]
    return max(turns) < PARALLEL


def _on_axis(point: NDArray[np.float64], axes: Axes) -> NDArray[np.float64]:
    """Return the point with small offsets across the approach axis removed."""
    local = axes.rotation() @ point
    local[:2] = np.where(np.abs(local[:2]) < ON_AXIS, 0.0, local[:2])
    return axes.rotation().T @ local

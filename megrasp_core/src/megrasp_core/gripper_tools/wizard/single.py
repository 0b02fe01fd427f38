"""A single moving jaw that closes against a fixed one, a part of the palm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.errors import DescriptionError

from .fingers import Finger, joint_axes
from .gaps import first_contact
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition

OUTER = 0.65
"""The jaw meets the fixed one with what lies beyond this share of its length from its joint; at
its root it always touches."""

TOUCH = 0.004
SAMPLES = 25


def oppose_single(mechanism: Mechanism, motion: DriveMotion, finger: Finger) -> Opposition:
    """Return the opposition of one finger and the palm, its closed posture at the range's end.

    Raises:
        DescriptionError: the finger has several drives, or comes nowhere near the palm.
    """
    if len(finger.curl) != 1:
        raise DescriptionError(
            f"the only finger, '{finger.name}', has {len(finger.curl)} drives; expected two "
            "fingers, or one that one drive closes against the palm. Name the link that the "
            "fingers hang from: --root LINK"
        )
    drive = finger.curl[0]
    ends = []
    for length in (motion.low[drive], motion.high[drive]):
        lengths = motion.rest()
        lengths[drive] = length
        ends.append(lengths)
    rooms = [_room(mechanism, motion, finger, lengths)[0] for lengths in ends]
    start, end = ends if rooms[0] >= rooms[1] else ends[::-1]

    def gap(time: float) -> float:
        return _room(mechanism, motion, finger, start + time * (end - start))[0] - TOUCH

    time, _ = first_contact(gap)
    closed = start + time * (end - start)
    if _room(mechanism, motion, finger, closed)[0] > 0.5 * max(rooms):
        raise DescriptionError(
            f"the only finger, '{finger.name}', does not close against the palm; name the link "
            "that both jaws hang from: --root LINK"
        )
    # Half-way, the end of the jaw is nearest to what it closes on: the closing axis joins the two.
    half = start + 0.5 * time * (end - start)
    _, own, other = _room(mechanism, motion, finger, half)
    axis = other - own
    axis = axis / np.linalg.norm(axis)
    middle = (other + own) / 2.0
    palm = tuple(int(b) for b in mechanism.palm if (mechanism.owner == b).any())
    return Opposition(((finger,), ()), start, end, axis, middle, 1.0, 1.0, False, fixed=((), palm))


def _room(
    mechanism: Mechanism, motion: DriveMotion, finger: Finger, lengths: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance (m) from the jaw's end to the palm, and the nearest points (3,) of jaw
    and palm, model frame.
    """
    poses = motion.poses(lengths)
    points = mechanism.surface(poses, finger.tip)
    if not finger.sliding:
        anchor = joint_axes(motion, lengths)[0][finger.moving[-1]]
        reach = np.linalg.norm(points - anchor, axis=1)
        points = points[reach >= OUTER * reach.max()]
    palm = mechanism.surface(poses, mechanism.palm)
    if not len(palm):
        return float("inf"), np.zeros(3), np.zeros(3)
    distance, index = KDTree(palm).query(points)
    nearest = int(np.argmin(distance))
    other = palm[np.asarray(index)[nearest]]
    return float(np.asarray(distance)[nearest]), points[nearest], other

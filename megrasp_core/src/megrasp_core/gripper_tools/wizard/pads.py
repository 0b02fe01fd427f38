"""Pads of jaws: the flat inner faces near the tips, and what lies between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .profile import CELL, Profile

TIP_SHARE = 0.2
"""Share of the facing depth, from the tips, that surely belongs to the pad."""

FLAT = 0.0015
"""Room along a pad may differ this much (m) where the fingers slide, so stay parallel."""

STRAIGHT = 0.0025
"""The same against a straight line where the fingers turn, so open at an angle."""

ROUNDED_BINS = 3
BULGE_BINS = 2

SKIPPED_BINS = 2
"""A notch of this many cells does not end a pad."""


@dataclass(frozen=True)
class Pad:
    """A pad pair in a posture.

    `length` (m) of the faces along the approach axis, `tip` (m) where they end along it, `room`
    (m) the smallest room over them, `middle` (3,) their middle, model frame. `opposite`: whether
    the faces are opposite; fingers around a centre pass beside each other.
    """

    length: float
    tip: float
    room: float
    middle: NDArray[np.float64]
    opposite: bool = True


def find_pad(
    profile: Profile, axis: NDArray[np.float64], turning: bool, length: float | None = None
) -> Pad | None:
    """Return the pad of a profile whose first basis vector is the approach; None without one.

    Args:
        profile: room between the groups.
        axis: the closing axis (3,) it was made along.
        turning: whether the fingers turn (the faces may be at an angle).
        length: length of the pad where it is known from another posture.
    """
    if not len(profile.room):
        return None
    depth = profile.cells[:, 0]
    bins = np.floor(depth / CELL).astype(int)
    levels = np.unique(bins)
    room = np.array([profile.room[bins == level].min() for level in levels])
    tip = profile.end
    if length is None:
        length = tip - _flat_start(levels, room, turning) * CELL
    inside = depth >= min(tip - length, levels[-1] * CELL)
    side = profile.cells[inside, 1]
    middle = (
        (tip - length / 2.0) * profile.across[0]
        + (side.min() + side.max()) / 2.0 * profile.across[1]
        + float(np.median(profile.middle[inside])) * axis
    )
    return Pad(length, tip, float(profile.room[inside].min()), middle)


def _flat_start(levels: NDArray[np.int64], room: NDArray[np.float64], turning: bool) -> int:
    """Return the first level down to which the room stays flat, or straight where fingers turn."""
    count = len(levels)
    sure = max(2, round(TIP_SHARE * count))
    taken = list(range(max(count - sure, 0), count))
    skipped = 0
    for index in range(count - sure - 1, -1, -1):
        if _fits((levels * CELL).astype(np.float64), room, taken, index, turning):
            taken.append(index)
            skipped = 0
        else:
            skipped += 1
            if skipped > SKIPPED_BINS:
                break
    closest = _closest(room, taken)
    if not turning and len(closest) < BULGE_BINS and max(closest) < count - ROUNDED_BINS:
        # An edge of what the finger stands on, no face.
        taken = [index for index in taken if index > max(closest)]
        closest = _closest(room, taken)
    if not turning and max(closest) < count - ROUNDED_BINS:
        # A bulge, not just rounded tips: its middle is the pad's.
        return round(2.0 * float(np.mean(levels[closest])) - float(levels[-1]))
    return int(levels[min(taken)])


def _closest(room: NDArray[np.float64], taken: list[int]) -> list[int]:
    """Return the levels (indices) at which the room is as small as anywhere."""
    return [index for index in taken if room[index] <= np.min(room[taken]) + FLAT]


def _fits(
    depth: NDArray[np.float64],
    room: NDArray[np.float64],
    taken: list[int],
    index: int,
    turning: bool,
) -> bool:
    if not turning:
        # Less room than nearer to the tip is a bulge of the same pad.
        return bool(room[index] <= np.min(room[taken]) + FLAT)
    line = np.polynomial.Polynomial.fit(depth[taken], room[taken], 1)
    return bool(abs(room[index] - line(depth[index])) <= STRAIGHT)

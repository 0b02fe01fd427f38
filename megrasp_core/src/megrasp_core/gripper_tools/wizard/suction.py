"""Tools that hold by suction: told apart from grippers, and refused."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import NO_SUCTION

from .fingers import BESIDE, Finger, leads_aside
from .gaps import Gaps
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition

ALIKE_MOTION = 0.1
"""Fingers whose ways differ by less than this share of them do not close."""

LEAST_MOTION = 1e-4
BESIDE_EACH_OTHER = 0.35
"""Slides whose ways have, half-way, a cosine below this to the line between them do not close."""

FAR_APART = 3.0
"""Turning parts that stay apart by so many times their way or more hold nothing."""


def refuse_cups(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: Sequence[Finger],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> None:
    """Raise DescriptionError for parts that move from `start` to `end` (n,) as cups do."""
    way = [motion.poses(lengths) for lengths in (start, end)]
    tips = np.array([[finger.tip_at(poses) for finger in fingers] for poses in way])
    _refuse_alike(fingers, tips)
    _refuse_sprung(mechanism, fingers, way[0], tips)
    _refuse_bellows(motion, fingers, start, end)


def _refuse_alike(fingers: Sequence[Finger], tips: NDArray[np.float64]) -> None:
    """Refuse parts that all move the same way, as the cups of a suction tool do."""
    moved = tips[1] - tips[0]
    apart = float(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max())
    if apart < ALIKE_MOTION * float(np.linalg.norm(moved, axis=1).max()):
        raise _closes_on_nothing(fingers, "all move the same way")


def _refuse_sprung(
    mechanism: Mechanism,
    fingers: Sequence[Finger],
    poses: NDArray[np.float64],
    tips: NDArray[np.float64],
) -> None:
    """Refuse parts that all slide along their own length, as cups on springs do."""
    moved = tips[1] - tips[0]
    for finger, way in zip(fingers, moved, strict=True):
        size = float(np.linalg.norm(way))
        if not finger.sliding or size < LEAST_MOTION:
            return
        if leads_aside(mechanism, poses, finger, way / size) >= BESIDE:
            return
    raise _closes_on_nothing(fingers, "move in and out of the base")


def _refuse_bellows(
    motion: DriveMotion,
    fingers: Sequence[Finger],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> None:
    """Refuse parts that slide beside each other, none towards another, as bellows do."""
    if not all(finger.sliding for finger in fingers):
        return
    before, middle, after = (motion.poses(v) for v in (start, (start + end) / 2.0, end))
    for a, b in itertools.combinations(fingers, 2):
        line = b.tip_at(middle) - a.tip_at(middle)
        way = (b.tip_at(after) - b.tip_at(before)) - (a.tip_at(after) - a.tip_at(before))
        size = float(np.linalg.norm(line) * np.linalg.norm(way))
        if size > 0.0 and abs(float(line @ way)) >= BESIDE_EACH_OTHER * size:
            return
    raise _closes_on_nothing(fingers, "slide beside each other")


def refuse_tilting(
    mechanism: Mechanism, motion: DriveMotion, fingers: Sequence[Finger], found: Opposition
) -> None:
    """Refuse parts that only tilt, as cups on joints do: far from each other however they turn."""
    if any(finger.sliding for finger in fingers):
        return
    ends = found.open, found.closed
    middles = [
        [np.mean([f.tip_at(motion.poses(v)) for f in group], axis=0) for group in found.groups]
        for v in ends
    ]
    way = float(np.linalg.norm(np.diff(middles[1], axis=0) - np.diff(middles[0], axis=0)))
    # Between roots, which never part, as well as between tips.
    gap = Gaps(mechanism.model).distance(motion.qpos(found.closed), found.tips(0), found.tips(1))
    if gap > FAR_APART * way:
        raise DescriptionError(
            f"{', '.join(finger.name for finger in fingers)} only tilt: by {1000 * way:.0f} mm, "
            f"and stay {1000 * gap:.0f} mm apart, so they hold little between: "
            f"{NO_SUCTION}. If they do hold something, give both postures: --open joint=value ... "
            "--closed joint=value ..."
        )


def _closes_on_nothing(fingers: Sequence[Finger], what: str) -> DescriptionError:
    names = ", ".join(finger.name for finger in fingers)
    return DescriptionError(f"{names} {what} and close on nothing: {NO_SUCTION}")

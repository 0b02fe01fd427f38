"""Postures of a jaw gripper: fingers that each follow one drive, alone or together."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .fingers import Finger, crossed_over, joint_axes
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition, divisions, facing
from .suction import refuse_cups, refuse_tilting

MAX_DRIVES = 6
ALIKE = 0.02
"""Divisions whose scores (cosines) differ by less oppose alike."""


def oppose_jaws(
    mechanism: Mechanism, motion: DriveMotion, fingers: Sequence[Finger]
) -> Opposition:
    """Return the opposition of a jaw gripper with at least two fingers.

    Every drive that moves a finger is put to either end of its range; the widest of these postures
    is the open one, the opposite ends the closed one, until `close_pads` finds where pads meet.

    Raises:
        DescriptionError: more drives than can be tried, or no way of moving them brings the
            fingers together.
    """
    drives = sorted({drive for finger in fingers for drive in finger.curl})
    if len(drives) > MAX_DRIVES:
        raise DescriptionError(
            f"{len(drives)} drives move the fingers; expected at most {MAX_DRIVES}. Give both "
            "postures with --open joint=value ... and --closed joint=value ..."
        )
    base = motion.rest()
    best: tuple[tuple[bool, float], NDArray[np.float64], NDArray[np.float64]] | None = None
    for ends in itertools.product((0, 1), repeat=len(drives)):
        start, end = base.copy(), base.copy()
        chosen = np.array(ends) == 0
        start[drives] = np.where(chosen, motion.low[drives], motion.high[drives])
        end[drives] = np.where(chosen, motion.high[drives], motion.low[drives])
        wide = _openness(motion, fingers, start)
        if best is None or wide > best[0]:
            best = wide, start, end
    assert best is not None  # product() yields at least one corner
    found = divide_jaws(mechanism, motion, fingers, best[1], best[2])
    refuse_tilting(mechanism, motion, fingers, found)
    return found


def divide_jaws(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: Sequence[Finger],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
) -> Opposition:
    """Divide the fingers into groups by how they move from `start` to `end` (n,)."""
    way = [motion.poses(lengths) for lengths in (start, end)]
    tips = np.array([[finger.tip_at(poses) for finger in fingers] for poses in way])
    refuse_cups(mechanism, motion, fingers, start, end)
    ways = [_way(division, fingers, tips) for division in divisions(fingers)]
    scores = sorted(way.score for way in ways)
    # Fingers around a centre oppose alike in several ways: then along an axis of the model, the
    # first of several.
    alike = [way for way in ways if way.score >= scores[-1] - ALIKE]
    best = max(alike, key=lambda way: _along_model(way.axis))
    margin = 1.0 - (max(scores[-2], 0.0) / max(scores[-1], 1e-9) if len(scores) > 1 else 0.0)
    middle = tips[0].mean(axis=0)
    return Opposition(best.groups, start, end, best.axis, middle, best.facing, margin, False)


def _openness(
    motion: DriveMotion, fingers: Sequence[Finger], lengths: NDArray[np.float64]
) -> tuple[bool, float]:
    """Return whether every finger stays on its own side, and the sum of distances between
    fingertips (m), negative where two have crossed over.
    """
    poses = motion.poses(lengths)
    anchors, _ = joint_axes(motion, lengths)
    out = 0.0
    for a, b in itertools.combinations(fingers, 2):
        apart = b.tip_at(poses) - a.tip_at(poses)
        roots = anchors[b.chain[0]] - anchors[a.chain[0]]
        crossed = not (a.sliding or b.sliding) and float(apart @ roots) < 0.0
        out += float(np.linalg.norm(apart)) * (-1.0 if crossed else 1.0)
    return not crossed_over(fingers, motion, lengths), out


def _along_model(axis: NDArray[np.float64]) -> tuple[float, int]:
    """Return how well a direction agrees with an axis of the model, and minus which one."""
    sizes = np.abs(axis)
    return round(float(sizes.max()), 2), -int(np.argmax(sizes))


@dataclass(frozen=True)
class _Way:
    """A division into groups: `score` by how well all fingers move towards the other group,
    `facing` by how well the groups do as wholes, `axis` (3,) of their relative motion.
    """

    groups: tuple[tuple[Finger, ...], tuple[Finger, ...]]
    score: float
    facing: float
    axis: NDArray[np.float64]


def _way(
    groups: tuple[tuple[Finger, ...], tuple[Finger, ...]],
    fingers: Sequence[Finger],
    tips: NDArray[np.float64],
) -> _Way:
    """Rate a division by the fingertips' places (2, fingers, 3) when open and when closed."""
    moved = tips[1] - tips[0]
    unit = moved / np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-9)
    index = [[fingers.index(finger) for finger in group] for group in groups]
    first, second = (tips[0][i].mean(axis=0) for i in index)
    pads = [unit[i].mean(axis=0) for i in index]
    wholes = [pad / max(float(np.linalg.norm(pad)), 1e-9) for pad in pads]
    # What both sides move alike is no closing.
    axis = moved[index[0]].mean(axis=0) - moved[index[1]].mean(axis=0)
    return _Way(
        groups,
        float(facing(first, pads[0], second, pads[1])),
        float(facing(first, wholes[0], second, wholes[1])),
        axis / max(float(np.linalg.norm(axis)), 1e-9),
    )

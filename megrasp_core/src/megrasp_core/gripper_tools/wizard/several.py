"""Several grippers on one base: refused, told from one whose fingers close on one place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .fingers import Finger
from .mechanism import Mechanism, shared_link
from .motion import DriveMotion

MOST_DRIVES = 6
LEAST_SHARE = 0.2
"""Each of two fingers that close on each other goes at least this share of their way."""

AGAINST = -0.5
"""The ways of two fingers that close on each other have this cosine at most."""

ALONG = 0.25
ACROSS = 1.0
FAR_ACROSS = 2.0
"""Pairs of one gripper meet so near to each other, in shares of their opening, along the line on
which they close and across it; those on one link with drives of their own are farther apart."""


@dataclass(frozen=True)
class _Pair:
    """Two fingers that close on each other: `meet` (3,) where, along the unit `axis` (3,), from
    `wide` (m) between their tips. `drives` and the `link` of the palm they both hang from.
    """

    fingers: tuple[Finger, Finger]
    meet: NDArray[np.float64]
    axis: NDArray[np.float64]
    wide: float
    drives: frozenset[int]
    link: str


def refuse_several(mechanism: Mechanism, motion: DriveMotion, fingers: Sequence[Finger]) -> None:
    """Raise DescriptionError where fingers close in pairs on places apart from each other."""
    drives = sorted({drive for finger in fingers for drive in finger.curl})
    if len(fingers) < 4 or len(drives) > MOST_DRIVES:
        return
    tips = []
    for ends in itertools.product((0, 1), repeat=len(drives)):
        lengths = motion.rest()
        lengths[drives] = np.where(np.array(ends) == 0, motion.low[drives], motion.high[drives])
        poses = motion.poses(lengths)
        tips.append([finger.tip_at(poses) for finger in fingers])
    pairs = _pairs(mechanism, fingers, np.array(tips))
    # Fingers come longest first; messages name them as the model does.
    pairs.sort(key=lambda pair: pair.fingers[0].links[0])
    for one, other in itertools.combinations(pairs, 2):
        if _apart(one, other):
            raise DescriptionError(_message(mechanism.model, one, other))


def _pairs(
    mechanism: Mechanism, fingers: Sequence[Finger], tips: NDArray[np.float64]
) -> list[_Pair]:
    """Return the pairs of fingers that come nearer to each other than to any other.

    Args:
        mechanism: its structure.
        fingers: all of them.
        tips: places (postures, fingers, 3) of the fingertips.
    """
    found: dict[tuple[int, int], tuple[float, _Pair]] = {}
    for i, j in itertools.combinations(range(len(fingers)), 2):
        apart = np.linalg.norm(tips[:, j] - tips[:, i], axis=1)
        opened, closed = int(apart.argmax()), int(apart.argmin())
        ways = tips[closed][[i, j]] - tips[opened][[i, j]]
        sizes = np.linalg.norm(ways, axis=1)
        if sizes.min() <= LEAST_SHARE * sizes.sum():
            continue
        if float(ways[0] @ ways[1]) > AGAINST * float(sizes.prod()):
            continue
        axis = (ways[0] - ways[1]) / np.linalg.norm(ways[0] - ways[1])
        a, b = sorted((fingers[i], fingers[j]), key=lambda finger: finger.links[0])
        both = a, b
        link = shared_link(mechanism.model, [finger.links[0] for finger in both], mechanism.palm)
        drives = frozenset(both[0].curl) | frozenset(both[1].curl)
        meet = tips[closed][[i, j]].mean(axis=0)
        pair = _Pair(both, meet, axis, float(apart[opened]), drives, link)
        found[i, j] = float(apart[closed]), pair
    nearest = [
        min((gap for key, (gap, _) in found.items() if k in key), default=np.inf)
        for k in range(len(fingers))
    ]
    return [pair for (i, j), (gap, pair) in found.items() if gap <= min(nearest[i], nearest[j])]


def _apart(one: _Pair, other: _Pair) -> bool:
    if {finger.name for finger in one.fingers} & {finger.name for finger in other.fingers}:
        return False
    between = other.meet - one.meet
    wide = max(one.wide, other.wide)
    along = max(abs(float(between @ pair.axis)) for pair in (one, other))
    across = min(
        float(np.linalg.norm(between - between @ pair.axis * pair.axis)) for pair in (one, other)
    )
    if along >= ALONG * wide:
        return True
    if one.link != other.link:
        return across >= ACROSS * wide
    return across >= FAR_ACROSS * wide and not one.drives & other.drives


def _message(model: mujoco.MjModel, one: _Pair, other: _Pair) -> str:
    names = [" and ".join(finger.name for finger in pair.fingers) for pair in (one, other)]
    distance = 1000.0 * float(np.linalg.norm(other.meet - one.meet))
    said = (
        f"{names[0]} close on each other, and so do {names[1]}, {distance:.0f} mm away: two "
        "grippers; expected one."
    )
    if _below(model, one.link, other.link) or _below(model, other.link, one.link):
        gone = " ".join(f"--without {finger.name}" for finger in other.fingers)
        return f"{said} Leave the fingers of one out: {gone}"
    return (
        f"{said} Name the link of the one that is meant: --root {one.link} or --root {other.link}"
    )


def _below(model: mujoco.MjModel, link: str, other: str) -> bool:
    """Whether a link is another or hangs from it."""
    body, above = model.body(link).id, model.body(other).id
    while body and body != above:
        body = int(model.body_parentid[body])
    return bool(body == above)

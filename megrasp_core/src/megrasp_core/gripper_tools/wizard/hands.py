"""Postures of a hand: fingers that curl by several drives against a thumb or each other.

Every finger curls along one line in joint space, all its curl drives in proportion, as a hand does
that closes on something unknown. The drives that turn a finger's plane (the thumb's base) are
searched for the side that opposes; those of the others rest.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .fingers import Finger, joint_gains
from .gaps import Gaps, first_contact
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition, divisions, facing
from .reach import Reach

STATES = 31
SPREAD_STEPS = 7
FEW_SPREAD_STEPS = 5
MANY_SPREADS = 3
OPEN_FACING = 0.9
"""The pre-grasp is the widest posture whose pads still look at each other this well (cosine)."""

SQUEEZE = 0.25
"""How far past the meeting, in shares of the curl, contact of the links is looked for."""

DEVIATION_COST = 0.05
LATE_COST = 0.5


@dataclass(frozen=True)
class _Side:
    """Pads of a group: `tip`, `pad` (combos, STATES, 3), the spread lengths (combos, k) and their
    cost (combos,). `row` (3,): from the middle of its fingertips to the last one beside it.
    """

    tip: NDArray[np.float64]
    pad: NDArray[np.float64]
    spread: NDArray[np.float64]
    cost: NDArray[np.float64]
    row: NDArray[np.float64]


@dataclass(frozen=True)
class _Plan:
    """A way to oppose: curl shares (0 extended, 1 flexed) of both sides, open and closed."""

    score: float
    facing: float
    combo: int
    open: tuple[float, float]
    closed: tuple[float, float]
    axis: NDArray[np.float64]
    middle: NDArray[np.float64]


def oppose_hand(
    mechanism: Mechanism, motion: DriveMotion, fingers: Sequence[Finger], size: float
) -> Opposition:
    """Return the best opposition of a hand with at least two fingers.

    Args:
        mechanism: its structure.
        motion: its joints.
        fingers: its fingers.
        size: reach of the longest finger (m).

    Raises:
        DescriptionError: no two groups of fingers come near each other.
    """
    gains = joint_gains(motion)
    still = {f.name: _side([f], motion, gains, search=False) for f in fingers}
    plans = []
    for first, second in divisions(fingers):
        # The thumb's side: the one that may be turned. Of two equals, either.
        one, other = (first, second) if len(first) <= len(second) else (second, first)
        moving = _side(one, motion, gains, search=len(one) == 1)
        fixed = _mean([still[f.name] for f in other])
        plan = _plan(moving, fixed, size, beside=False)
        if plan is None:
            plan = _plan(moving, fixed, size, beside=True)
        if plan is not None:
            plans.append((plan, one, other, moving))
    if not plans:
        raise DescriptionError(
            "no two groups of fingers come near each other wherever the joints are moved; give "
            "both postures with --open joint=value ... and --closed joint=value ..."
        )
    plans.sort(key=lambda item: -item[0].score)
    plan, one, other, moving = plans[0]
    margin = 1.0 - (plans[1][0].score / plan.score if len(plans) > 1 else 0.0)
    return _finish(mechanism, motion, plan, (tuple(one), tuple(other)), moving, margin)


def curl_lengths(motion: DriveMotion, finger: Finger, share: float) -> NDArray[np.float64]:
    """Return the lengths of a finger's curl drives at a share of their way from extended."""
    low, high = motion.low[list(finger.curl)], motion.high[list(finger.curl)]
    flexing = np.array(finger.flexing) > 0.0
    start, end = np.where(flexing, low, high), np.where(flexing, high, low)
    return start + share * (end - start)


def _side(
    group: Sequence[Finger], motion: DriveMotion, gains: NDArray[np.float64], search: bool
) -> _Side:
    shares = np.linspace(0.0, 1.0, STATES)
    parts = []
    for finger in group:
        rest = motion.rest()[list(finger.spread)]
        combos = _combos(motion, finger) if search else rest[None]
        curl = np.array([curl_lengths(motion, finger, share) for share in shares])
        lengths = np.concatenate(
            [np.tile(curl, (len(combos), 1)), np.repeat(combos, STATES, axis=0)], axis=1
        )
        states = Reach(motion, finger, gains).states(lengths)
        span = (motion.high - motion.low)[list(finger.spread)]
        cost = (np.abs(combos - rest) / np.maximum(span, 1e-9)).sum(axis=1)
        shape = (len(combos), STATES, 3)
        tip, pad = states.tip.reshape(shape), states.pad.reshape(shape)
        parts.append(_Side(tip, pad, combos, cost, np.zeros(3)))
    return _mean(parts) if len(parts) > 1 else parts[0]


def _combos(motion: DriveMotion, finger: Finger) -> NDArray[np.float64]:
    if not finger.spread:
        return np.zeros((1, 0))
    steps = SPREAD_STEPS if len(finger.spread) < MANY_SPREADS else FEW_SPREAD_STEPS
    rest = motion.rest()
    grids = [
        np.unique([*np.linspace(motion.low[d], motion.high[d], steps), rest[d]])
        for d in finger.spread
    ]
    return np.array(list(itertools.product(*grids))).reshape(-1, len(finger.spread))


def _mean(sides: Sequence[_Side]) -> _Side:
    tip = np.mean([side.tip for side in sides], axis=0)
    pad = np.mean([side.pad for side in sides], axis=0)
    away = np.array([side.tip[0, 0] for side in sides]) - tip[0, 0]
    row = away[int(np.argmax(np.linalg.norm(away, axis=1)))]
    return _Side(tip, pad, sides[0].spread, sides[0].cost, row)


def _plan(moving: _Side, fixed: _Side, size: float, beside: bool) -> _Plan | None:
    """Return the best plan over the moving side's spreads, None where the sides stay apart.

    A thumb meets the middle of the fingertips, or, with `beside`, any of their row.
    """
    touch = 0.1 * size
    best: _Plan | None = None
    for combo, tip in enumerate(moving.tip):
        between = fixed.tip[0][None] - tip[:, None]
        if beside:
            between = _off_row(between, fixed.row)
        apart = np.linalg.norm(between, axis=2)
        nearest = apart.min(axis=0)
        if nearest.min() > 2.0 * touch:
            continue
        # The first time the fingers, as they curl, come within reach of the thumb.
        close = np.flatnonzero(nearest <= max(touch, float(nearest.min())))
        j1 = int(close[0])
        i1 = int(apart[:, j1].argmin())
        plan = _opened(moving, fixed, combo, (i1, j1), size)
        if plan is not None and (best is None or plan.score > best.score):
            best = plan
    return best


def _off_row(between: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (..., 3) from the middle of a row without their part inside the row."""
    half = float(np.linalg.norm(row))
    if half < 1e-6:
        return between
    along = between @ (row / half)
    inside = np.clip(along, -half, half)
    return between - inside[..., None] * (row / half)


def _opened(
    moving: _Side, fixed: _Side, combo: int, meet: tuple[int, int], size: float
) -> _Plan | None:
    """Uncurl both sides alike from where they meet, as far as the pads look at each other."""
    tip_a, pad_a = moving.tip[combo], moving.pad[combo]
    tip_b, pad_b = fixed.tip[0], fixed.pad[0]
    steps = np.arange(0, meet[1] + 1)
    i, j = np.maximum(meet[0] - steps, 0), meet[1] - steps
    look = facing(tip_a[i], pad_a[i], tip_b[j], pad_b[j])
    wide = np.linalg.norm(tip_b[j] - tip_a[i], axis=1) / size
    if look.max() <= 0.0:
        return None
    good = np.flatnonzero(look >= OPEN_FACING * look.max())
    k = int(good[np.argmax(wide[good])])
    line = tip_b[j[k]] - tip_a[i[k]]
    late = j[0] / (STATES - 1)
    score = look[k] * wide[k] - DEVIATION_COST * moving.cost[combo] - LATE_COST * late * wide[k]
    last = STATES - 1
    return _Plan(
        score=float(score),
        facing=float(look[k]),
        combo=combo,
        open=(float(i[k] / last), float(j[k] / last)),
        closed=(meet[0] / last, meet[1] / last),
        axis=line / np.linalg.norm(line),
        middle=(tip_a[meet[0]] + tip_b[meet[1]]) / 2.0,
    )


def _finish(
    mechanism: Mechanism,
    motion: DriveMotion,
    plan: _Plan,
    groups: tuple[tuple[Finger, ...], tuple[Finger, ...]],
    moving: _Side,
    margin: float,
) -> Opposition:
    """Close until the links touch, then state both postures as lengths of all drives."""
    base = motion.rest()
    if len(groups[0]) == 1:
        base[list(groups[0][0].spread)] = moving.spread[plan.combo]

    def at(time: float) -> NDArray[np.float64]:
        lengths = base.copy()
        for side, group in enumerate(groups):
            start, end = plan.open[side], plan.closed[side]
            share = min(start + time * (1.0 + SQUEEZE) * (end - start), 1.0)
            for finger in group:
                lengths[list(finger.curl)] = curl_lengths(motion, finger, share)
        return lengths

    gaps = Gaps(mechanism.model)
    tips = [[body for finger in group for body in finger.tip] for group in groups]
    time, contact = first_contact(lambda t: gaps.distance(motion.qpos(at(t)), tips[0], tips[1]))
    return Opposition(
        groups, at(0.0), at(time), plan.axis, plan.middle, plan.facing, margin, contact
    )

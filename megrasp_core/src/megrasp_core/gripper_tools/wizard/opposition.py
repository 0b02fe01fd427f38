"""What jaws and hands have in common: two opposing groups of fingers and how they close."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fingers import Finger


@dataclass(frozen=True)
class Opposition:
    """Two opposing groups of fingers and the postures between which they close.

    `groups`: fingers of both sides. `fixed`: links of either side that do not move: a single
    finger closes against the palm. `open`, `closed`: lengths (n,) of all drives. `axis` (3,): unit
    direction from the first group to the second, along which they close, model frame. `middle`
    (3,): between the pads. `facing`: cosine by which the pads look at each other (1: straight).
    `margin`: how much better this division into groups is than the next (1 where there is no
    other). `contact`: whether the groups touch in the closed posture. `meet` (3,): where the
    single finger meets the fixed side, model frame, None with fingers on both sides.
    """

    groups: tuple[tuple[Finger, ...], tuple[Finger, ...]]
    open: NDArray[np.float64]
    closed: NDArray[np.float64]
    axis: NDArray[np.float64]
    middle: NDArray[np.float64]
    facing: float
    margin: float
    contact: bool
    fixed: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
    meet: NDArray[np.float64] | None = None

    def tips(self, side: int) -> tuple[int, ...]:
        """Return the last links of one side."""
        ends = [body for finger in self.groups[side] for body in finger.tip]
        return (*ends, *self.fixed[side])


def divisions(
    fingers: Sequence[Finger],
) -> list[tuple[tuple[Finger, ...], tuple[Finger, ...]]]:
    """Return the ways to divide fingers into two opposing groups, each once."""
    first, *rest = fingers
    out = []
    for size in range(len(rest)):
        for chosen in itertools.combinations(rest, size):
            own = (first, *chosen)
            out.append((own, tuple(f for f in fingers if f not in own)))
    return out


def facing(
    tip_a: NDArray[np.float64],
    pad_a: NDArray[np.float64],
    tip_b: NDArray[np.float64],
    pad_b: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return how well pads look at each other: the smaller of the cosines to the line between.

    Args:
        tip_a: places of one pad (..., 3).
        pad_a: where it looks (..., 3), a mean of unit vectors.
        tip_b: places of the other (..., 3).
        pad_b: where that looks (..., 3).
    """
    line = tip_b - tip_a
    line = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), 1e-9)
    return np.minimum((pad_a * line).sum(axis=-1), -(pad_b * line).sum(axis=-1))

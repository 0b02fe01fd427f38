"""The numbers that make a gripper of the family."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .ranges import (
    CENTRIC,
    CROSS,
    PAIR,
    PAIRED,
    TWO_ONE,
)

CLEARANCE = 0.001


@dataclass(frozen=True)
class Placement:
    """Where a finger stands: it moves along the direction (cos, sin) of `angle` (rad) in XY when
    it closes; `shift` (m) to its left; `group` 0 lies on -X, 1 on +X.
    """

    angle: float
    shift: float
    group: int


@dataclass(frozen=True)
class FamilyParameters:
    """A gripper of the family in numbers; metres, radians, newtons (meanings: ranges.RANGES)."""

    kind: str
    seed: int
    layout: str
    motion: str
    pad: str
    palm: str
    opening: float
    gap: float
    finger_length: float
    finger_width: float
    finger_thickness: float
    taper: float
    pad_length: float
    pad_thickness: float
    root_offset: float
    carriage_height: float
    crank_length: float
    crank_lean: float
    pivot_offset: float
    pivot_radius: float
    parallel_share: float
    spread: float
    palm_height: float
    palm_depth: float
    palm_span: float
    palm_shift: float
    flange_radius: float
    flange_height: float
    force: float

    @property
    def open_radius(self) -> float:
        """Distance of an open pad from the gripper's axis."""
        return self.opening / 2

    @property
    def closed_radius(self) -> float:
        """Distance of a closed pad from the gripper's axis: pads that meet from several sides
        leave room for each other.
        """
        if self.layout not in (CENTRIC, CROSS):
            return self.gap / 2
        half = self.finger_width / 2 + CLEARANCE
        return max(self.gap / 2, half / math.tan(math.pi / self.count))

    @property
    def count(self) -> int:
        """Number of fingers."""
        return {PAIR: 2, CENTRIC: 3, TWO_ONE: 3, CROSS: 4, PAIRED: 4}[self.layout]

    @property
    def side_by_side(self) -> float:
        """Shift of fingers that stand side by side."""
        return self.finger_width / 2 + self.spread

    def placements(self) -> tuple[Placement, ...]:
        """Return where the fingers stand."""
        left = self.side_by_side
        if self.layout == PAIR:
            return Placement(0.0, 0.0, 0), Placement(math.pi, 0.0, 1)
        if self.layout == TWO_ONE:
            two = (Placement(math.pi, side, 1) for side in (-left, left))
            return (Placement(0.0, 0.0, 0), *two)
        if self.layout == PAIRED:
            return tuple(
                Placement(group * math.pi, side, group)
                for group in (0, 1)
                for side in (-left, left)
            )
        first = 0.0 if self.layout == CENTRIC else math.pi / 4
        angles = [first + 2 * math.pi * i / self.count for i in range(self.count)]
        return tuple(Placement(a, 0.0, 0 if math.cos(a) > 0 else 1) for a in angles)

    def along_x(self, radius: float) -> float:
        """Width along X between the two groups' pads at this distance from the axis."""
        sides = {0: 0.0, 1: 0.0}
        for place in self.placements():
            sides[place.group] = abs(math.cos(place.angle)) * radius
        return sides[0] + sides[1]

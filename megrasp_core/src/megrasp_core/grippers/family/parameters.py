"""The numbers that make a gripper of the family, drawn from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .motion import kinematics
from .ranges import (
    CENTRIC,
    CROSS,
    FAMILY_KINDS,
    HINGE,
    LINKAGE,
    PADS,
    PAIR,
    PAIRED,
    PALMS,
    RANGES,
    SLIDE,
    TWO_ONE,
)

STREAM = 0x6772
ATTEMPTS = 1000
MAX_SWING = 1.0
MIN_STROKE = 0.018
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


def draw_parameters(seed: int, kind: str | None = None) -> FamilyParameters:
    """Return the parameters of a seed, of this kind or one drawn with the seed.

    Raises InvalidRequestError for a negative seed or an unknown kind.
    """
    if seed < 0:
        raise InvalidRequestError(f"seed {seed} is negative; expected a whole number from 0.")
    names = list(FAMILY_KINDS)
    if kind is not None and kind not in names:
        raise InvalidRequestError(
            f"unknown kind of gripper {kind!r}; expected one of {', '.join(names)}."
        )
    rng = np.random.default_rng([STREAM, seed])
    drawn = names[int(rng.integers(len(names)))]
    for _ in range(ATTEMPTS):
        parameters = _draw(rng, kind or drawn, seed)
        if _feasible(parameters):
            return parameters
    raise RuntimeError(
        f"no gripper of kind {kind or drawn} came out in {ATTEMPTS} draws for seed {seed}; the "
        "ranges exclude each other, widen them"
    )


def _draw(rng: np.random.Generator, kind: str, seed: int) -> FamilyParameters:
    def number(name: str) -> float:
        return round(float(rng.uniform(*RANGES[name])), 5)

    def choice(values: tuple[str, ...]) -> str:
        return values[int(rng.integers(len(values)))]

    layouts, motions = FAMILY_KINDS[kind]
    layout, motion, pad, palm = choice(layouts), choice(motions), choice(PADS), choice(PALMS)
    wide = layout == PAIR
    shifted = float(rng.random()) < 0.25
    thick = float(rng.random()) < 0.5
    width = number("finger_width" if wide else "narrow_finger_width")
    shift = number("palm_shift")
    plain = (
        "opening",
        "gap",
        "finger_length",
        "finger_thickness",
        "taper",
        "pad_length",
        "pad_thickness",
        "root_offset",
        "carriage_height",
        "crank_length",
        "crank_lean",
        "pivot_offset",
        "pivot_radius",
        "parallel_share",
        "spread",
        "palm_depth",
        "palm_span",
        "flange_radius",
        "flange_height",
        "force",
    )
    return FamilyParameters(
        kind=kind,
        seed=seed,
        layout=layout,
        motion=motion,
        pad=pad,
        palm=palm,
        finger_width=width,
        palm_height=number("thick_palm" if thick else "thin_palm"),
        palm_shift=shift if shifted else 0.0,
        **{name: number(name) for name in plain},
    )


def _feasible(p: FamilyParameters) -> bool:
    """Return whether the parts of the gripper fit each other."""
    stroke = p.open_radius - p.closed_radius
    if stroke < MIN_STROKE or p.pad_length > p.finger_length - 0.006:
        return False
    if p.flange_height > 0.6 * p.palm_height:
        return False
    # A domed or rounded pad needs room to bulge in, or it is flat.
    if p.pad in ("rounded", "barrel", "domed", "vee") and p.pad_thickness < 0.004:
        return False
    if p.motion == SLIDE:
        return _depth_fits(kinematics(p).tcp_depth)
    if p.motion == LINKAGE:
        swing = math.sin(p.crank_lean) + stroke / p.crank_length
        if swing > math.sin(MAX_SWING):
            return False
    if p.pivot_offset < p.pad_thickness + p.finger_thickness / 2 and p.motion == LINKAGE:
        return False
    motion = kinematics(p)
    # Pivots keep off each other and off the axis.
    room = p.pivot_radius + p.finger_thickness / 2 + 0.002
    if p.layout in (CENTRIC, CROSS):
        room = max(room, (p.finger_width / 2 + 0.004) / math.tan(math.pi / p.count))
    if motion.pivot < room:
        return False
    if p.motion == HINGE and motion.open - motion.closed > MAX_SWING:
        return False
    return _depth_fits(motion.tcp_depth)


def _depth_fits(depth: float) -> bool:
    low, high = RANGES["tcp_depth"]
    return low <= depth <= high

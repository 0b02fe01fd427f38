"""Parameters of the family drawn from a seed, again and again until the parts fit each other."""

from __future__ import annotations

import math

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .motion import kinematics
from .parameters import FamilyParameters
from .ranges import (
    CENTRIC,
    CROSS,
    FAMILY_KINDS,
    HINGE,
    LINKAGE,
    PADS,
    PAIR,
    PALMS,
    RANGES,
    SLIDE,
)

STREAM = 0x6772
ATTEMPTS = 1000
MAX_SWING = 1.0
MIN_STROKE = 0.018


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

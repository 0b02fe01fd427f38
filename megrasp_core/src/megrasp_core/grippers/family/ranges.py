"""What the family varies, and how far.

The ranges enclose opening, closed gap and TCP depth of the real jaws (a test holds the shipped
descriptions against them) with some room on both sides. Every number is drawn on its own; nothing
is fitted to a gripper.
"""

from __future__ import annotations

from typing import NamedTuple

SLIDE, LINKAGE, HINGE = MOTIONS = ("slide", "linkage", "hinge")
PAIR, CENTRIC, TWO_ONE, CROSS, PAIRED = LAYOUTS = (
    "pair",
    "centric",
    "two_one",
    "cross",
    "paired",
)
PADS = ("flat", "rounded", "barrel", "domed", "vee")
PALMS = ("block", "stadium", "barrel")

FAMILY_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "parallel_slide": ((PAIR,), (SLIDE,)),
    "parallel_linkage": ((PAIR,), (LINKAGE,)),
    "angular": ((PAIR,), (HINGE,)),
    "centric": ((CENTRIC,), MOTIONS),
    "two_against_one": ((TWO_ONE,), MOTIONS),
    "four_finger": ((CROSS, PAIRED), MOTIONS),
}
"""Kind of the family -> layouts of its fingers, motions they may make."""


class Range(NamedTuple):
    """Bounds of a number that is drawn evenly between them."""

    low: float
    high: float


RANGES: dict[str, Range] = {
    # Twice the distance of an open, and of a closed, pad from the gripper's axis.
    "opening": Range(0.048, 0.180),
    "gap": Range(0.0, 0.018),
    # Height of the TCP over the mounting face.
    "tcp_depth": Range(0.075, 0.205),
    "finger_length": Range(0.030, 0.110),
    "finger_width": Range(0.010, 0.064),
    "narrow_finger_width": Range(0.008, 0.028),
    "finger_thickness": Range(0.006, 0.020),
    # Thickness of the finger behind the pad, relative to that at its root.
    "taper": Range(0.4, 1.0),
    "pad_length": Range(0.014, 0.060),
    "pad_thickness": Range(0.002, 0.010),
    # How far a sliding finger's root lies outside its pad.
    "root_offset": Range(0.0, 0.030),
    "carriage_height": Range(0.006, 0.022),
    "crank_length": Range(0.035, 0.110),
    # Lean of a closed linkage's crank, positive outwards (rad).
    "crank_lean": Range(-0.40, 0.25),
    "pivot_offset": Range(0.010, 0.040),
    "pivot_radius": Range(0.004, 0.009),
    # Width between angular pads where they are parallel, relative to the opening.
    "parallel_share": Range(0.0, 0.5),
    # Distance of each of two fingers side by side from the middle between them, less half a width.
    "spread": Range(0.002, 0.035),
    "thin_palm": Range(0.018, 0.050),
    "thick_palm": Range(0.050, 0.115),
    # Half the palm along Y, and its half width relative to what the mechanism spans.
    "palm_depth": Range(0.015, 0.055),
    "palm_span": Range(0.75, 1.15),
    # Shift of the palm along Y against the fingers, where it is drawn.
    "palm_shift": Range(-0.020, 0.020),
    "flange_radius": Range(0.022, 0.045),
    "flange_height": Range(0.004, 0.015),
    # Pressing force of a finger (N).
    "force": Range(35.0, 80.0),
}
"""Lengths in metres unless the comment says otherwise."""

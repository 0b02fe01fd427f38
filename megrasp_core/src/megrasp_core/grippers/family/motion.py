"""Where pads and pivots lie in the open and the closed posture, for the three motions.

Lengths are taken in the half-plane of one finger: the distance from the gripper's axis and the
height over the mounting face. Angles are positive where the finger leans outwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .parameters import FamilyParameters
from .ranges import LINKAGE, SLIDE

# The clear width counts over this height about the TCP.
PATCH = 0.008


class Kinematics(NamedTuple):
    """Positions of the driven joint and the lengths that follow.

    open, closed: joint position (m for a slide, else rad). pivot: distance of the hinge from the
    axis; for a slide, of the finger's root when closed. base: height of the hinge, or of the
    finger's foot. face: distance (m) of the pad's face inward of the pivot, where the pad is
    upright. tip: height of the fingertip over the base (slide, hinge) or over the end of the
    crank. lever: force arm (m) of the joint, 1 for a slide. clear: smallest distance of the open
    pad from the axis about the height of the TCP.
    """

    open: float
    closed: float
    pivot: float
    base: float
    face: float
    tip: float
    lever: float
    tcp_depth: float
    clear: float


def kinematics(p: FamilyParameters) -> Kinematics:
    """Return the kinematics of a gripper's fingers, which are all alike."""
    if p.motion == SLIDE:
        return _slide(p)
    return _linkage(p) if p.motion == LINKAGE else _hinge(p)


def _slide(p: FamilyParameters) -> Kinematics:
    tip = p.carriage_height + p.finger_length
    face = p.pad_thickness + p.finger_thickness / 2 + p.root_offset
    return Kinematics(
        open=p.open_radius - p.closed_radius,
        closed=0.0,
        pivot=p.closed_radius + face,
        base=p.palm_height,
        face=face,
        tip=tip,
        lever=1.0,
        tcp_depth=p.palm_height + tip - p.pad_length / 2,
        clear=p.open_radius,
    )


def _linkage(p: FamilyParameters) -> Kinematics:
    length, closed = p.crank_length, p.crank_lean
    sine = math.sin(closed) + (p.open_radius - p.closed_radius) / length
    opened = math.asin(min(1.0, sine))
    base = p.palm_height + p.pivot_radius / 2
    rise = length * (math.cos(opened) + math.cos(closed)) / 2
    return Kinematics(
        open=opened,
        closed=closed,
        pivot=p.closed_radius + p.pivot_offset - length * math.sin(closed),
        base=base,
        face=p.pivot_offset,
        tip=p.finger_length,
        lever=length,
        tcp_depth=base + rise + p.finger_length - p.pad_length / 2,
        clear=p.open_radius,
    )


def _hinge(p: FamilyParameters) -> Kinematics:
    base = p.palm_height + p.pivot_radius / 2
    upright = p.closed_radius + p.parallel_share * (p.open_radius - p.closed_radius)
    face = p.pad_thickness + p.finger_thickness / 2 + p.root_offset
    pivot = upright + face
    middle = p.finger_length - p.pad_length / 2
    opened = _angle_at(p.open_radius - pivot, -face, middle)
    closed = _angle_at(p.closed_radius - pivot, -face, p.finger_length)
    depth = base + (_height(-face, middle, opened) + _height(-face, middle, closed)) / 2
    level = (depth - PATCH - base - face * math.sin(opened)) / math.cos(opened)
    clear = pivot - face * math.cos(opened) + level * math.sin(opened)
    return Kinematics(
        opened,
        closed,
        pivot,
        base,
        face,
        p.finger_length,
        middle,
        depth,
        min(p.open_radius, clear),
    )


def _angle_at(distance: float, outward: float, up: float) -> float:
    """Lean at which the point (outward, up) of a link is `distance` outward of its hinge."""
    sine = distance / math.hypot(outward, up)
    return math.asin(max(-1.0, min(1.0, sine))) - math.atan2(outward, up)


def _height(outward: float, up: float, lean: float) -> float:
    return up * math.cos(lean) - outward * math.sin(lean)

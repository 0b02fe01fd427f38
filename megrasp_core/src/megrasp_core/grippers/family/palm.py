"""The palm: flange, housing, rails or forks that carry the fingers."""

from __future__ import annotations

import math

import numpy as np

from .finger import half_width, pivot_blocks, reach
from .motion import Kinematics
from .parameters import FamilyParameters
from .ranges import CENTRIC, CROSS, SLIDE
from .shapes import Part, box, cylinder, prism, turned

CORNER_POINTS = 5


def palm_parts(p: FamilyParameters, k: Kinematics) -> list[Part]:
    """Return the palm's parts in the gripper frame."""
    parts = [
        cylinder("flange", (0, 0, 0), (0, 0, p.flange_height), p.flange_radius),
        *_housing(p, k),
    ]
    for index, place in enumerate(p.placements()):
        carriers = _rails(p, k) if p.motion == SLIDE else pivot_blocks(p, k)
        parts += [
            turned(part, f"{part.name}_{index}", place.angle, place.shift) for part in carriers
        ]
    return parts


def _housing(p: FamilyParameters, k: Kinematics) -> list[Part]:
    low, high = 0.8 * p.flange_height, p.palm_height
    if p.layout in (CENTRIC, CROSS):
        radius = max(_span(p, k), half_width(p) + 0.012)
        if p.palm == "stadium":
            outline = _rounded(0.92 * radius, 0.92 * radius, 0.45 * radius)
            return [prism("housing", outline, 2, low, high)]
        if p.palm == "barrel":
            neck = max(0.6 * radius, min(p.flange_radius, radius))
            waist = low + 0.55 * (high - low)
            return [
                cylinder("neck", (0, 0, low), (0, 0, waist), neck),
                cylinder("housing", (0, 0, waist), (0, 0, high), radius),
            ]
        return [cylinder("housing", (0, 0, low), (0, 0, high), radius)]
    sides = [abs(place.shift) for place in p.placements()]
    x, y, shift = _span(p, k), max(p.palm_depth, max(sides) + half_width(p)), p.palm_shift
    if p.palm == "stadium":
        outline = _rounded(x, y, 0.9 * min(x, y)) + np.array([0.0, shift])
        return [prism("housing", outline, 2, low, high)]
    if p.palm == "barrel":
        waist = low + 0.5 * (high - low)
        radius = min(max(p.flange_radius, 0.8 * y), 1.2 * x)
        return [
            cylinder("neck", (0, shift, low), (0, shift, waist + 0.002), radius),
            box("housing", (-x, shift - y, waist), (x, shift + y, high)),
        ]
    cut = min(0.3 * (high - low), 0.25 * x)
    outline = [(-x + cut, low), (x - cut, low), (x, low + cut), (x, high), (-x, high)]
    return [prism("housing", [*outline, (-x, low + cut)], 1, shift - y, shift + y)]


def _span(p: FamilyParameters, k: Kinematics) -> float:
    """Half width of the housing; pivots stand on it, slides may run out over its edge."""
    share = p.palm_span if p.motion == SLIDE else max(1.0, p.palm_span)
    return max(share * reach(p, k), 0.02)


def _rails(p: FamilyParameters, k: Kinematics) -> list[Part]:
    """Return the two rails below a finger's carriage, on the axis with the finger's axes."""
    outer, width = reach(p, k), 0.35 * max(p.finger_width, 0.02)
    inner = min(k.pivot, outer) - 0.012
    # Where they run out over the housing's edge they are seen from below.
    deep = min(0.008, 0.4 * p.palm_height) if _span(p, k) < outer else 0.001
    high = p.palm_height + 0.0005
    return [
        box(f"rail_{name}", (-outer, y - 0.003, high - deep), (-inner, y + 0.003, high + 0.0005))
        for name, y in (("a", -width), ("b", width))
    ]


def _rounded(x: float, y: float, radius: float) -> np.ndarray:
    """Return the outline (N, 2) of a rectangle with half edges x, y and rounded corners."""
    radius = min(radius, x, y)
    angles = np.linspace(0.0, math.pi / 2, CORNER_POINTS)
    corner = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1) + [x - radius, y - radius]
    return np.concatenate([corner * signs for signs in ((1, 1), (-1, 1), (-1, -1), (1, -1))])

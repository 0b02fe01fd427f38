"""The finger: root, beam, back plate and pad, and what moves it.

Finger frame: X inward (the way it closes), Y along the pad, Z approach. Its origin is the pivot
or, for a slide, the middle of the finger's root at the height of the foot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from .motion import Kinematics
from .parameters import FamilyParameters
from .ranges import LINKAGE, SLIDE
from .shapes import Part, box, capsule, cylinder, ellipsoid, hull, prism

ARC_POINTS = 7
CHAMFER = 0.15


@dataclass(frozen=True)
class Link:
    """A body of the finger in its parent's frame: origin (3,), joint axis (3,), whether its joint
    follows the driven one, parts and the bodies on it.
    """

    name: str
    origin: tuple[float, float, float]
    hinge: bool
    axis: tuple[int, int, int]
    follows: bool
    parts: tuple[Part, ...]
    children: tuple[Link, ...] = field(default=())


def finger_links(p: FamilyParameters, k: Kinematics) -> tuple[Link, ...]:
    """Return the finger's links that hang on the palm, the driven one first.

    Their origins are in a frame on the gripper's axis with the axes of the finger frame.
    """
    at = (-k.pivot, 0.0, k.base)
    if p.motion == SLIDE:
        parts = [_carriage(p), *_blade(p, k.face, p.carriage_height, k.tip)]
        return (Link("slide", at, False, (-1, 0, 0), False, tuple(parts)),)
    if p.motion == LINKAGE:
        return _linkage(p, k)
    knuckle = _axle("knuckle", (0.0, 0.0, 0.0), p.pivot_radius, _link_width(p))
    parts = [knuckle, *_blade(p, k.face, 0.0, k.tip)]
    return (Link("swing", at, True, (0, -1, 0), False, tuple(parts)),)


def pivot_blocks(p: FamilyParameters, k: Kinematics) -> list[Part]:
    """Return the fork of the palm that carries the pivots, on the axis with the finger's axes."""
    if p.motion == SLIDE:
        return []
    width, radius = _link_width(p), p.pivot_radius
    low = p.palm_height - 0.001
    outline = [
        (-k.pivot - 1.4 * radius, low),
        (-k.pivot + 1.4 * radius, low),
        (-k.pivot + 1.1 * radius, k.base + 0.5 * radius),
        (-k.pivot, k.base + 1.1 * radius),
        (-k.pivot - 1.1 * radius, k.base + 0.5 * radius),
    ]
    cheek = min(0.003, width / 5)
    inner = width / 2 + 0.0005
    return [
        prism("cheek_a", outline, 1, -inner - cheek, -inner),
        prism("cheek_b", outline, 1, inner, inner + cheek),
    ]


def reach(p: FamilyParameters, k: Kinematics) -> float:
    """Distance from the axis to the outer end of what the palm carries."""
    if p.motion == SLIDE:
        return k.pivot + k.open + _carriage_half(p)
    return k.pivot + 1.5 * p.pivot_radius


def half_width(p: FamilyParameters) -> float:
    """Half the width of a finger at its foot, fork included."""
    return _link_width(p) / 2 + 0.004


def _linkage(p: FamilyParameters, k: Kinematics) -> tuple[Link, ...]:
    """Return the parallelogram: a crank with the fingertip on it, which stays upright, and a bar
    of the same lean with its pivots inward and lower.
    """
    width, radius = _link_width(p), p.pivot_radius
    knuckle = _axle("knuckle", (0.0, 0.0, 0.0), radius, width)
    end = (0.0, 0.0, p.crank_length)
    crank = (
        knuckle,
        box(
            "crank",
            (-0.8 * radius, -0.35 * width, 0.0),
            (0.8 * radius, 0.35 * width, p.crank_length),
        ),
    )
    inward, lower = _bar_offset(p, k)
    lug = hull(
        "lug",
        [
            (x + dx, y, z + dz)
            for x, z in ((0.0, 0.0), (inward, -lower))
            for dx, dz in ((-radius / 2, 0), (radius / 2, 0), (0, -radius / 2), (0, radius / 2))
            for y in (-0.25 * width, 0.25 * width)
        ],
    )
    tip = (
        _axle("heel", (0.0, 0.0, 0.0), 0.9 * radius, width),
        lug,
        *_blade(p, k.face, 0.0, k.tip),
    )
    rods = tuple(
        capsule(
            f"bar_{side}",
            (0.0, y, 0.0),
            (0.0, y, p.crank_length),
            0.5 * radius,
        )
        for side, y in (("a", -0.4 * width), ("b", 0.4 * width))
    )
    tip_link = Link("tip", end, True, (0, 1, 0), True, tip)
    bar_at = (-k.pivot + inward, 0.0, k.base - lower)
    return (
        Link("crank", (-k.pivot, 0.0, k.base), True, (0, -1, 0), False, crank, (tip_link,)),
        Link("bar", bar_at, True, (0, -1, 0), True, rods),
    )


def _link_width(p: FamilyParameters) -> float:
    return min(p.finger_width, 0.030)


def _carriage_half(p: FamilyParameters) -> float:
    return 0.5 * p.finger_thickness + 0.004


def _bar_offset(p: FamilyParameters, k: Kinematics) -> tuple[float, float]:
    inward = min(max(k.pivot - 1.5 * p.pivot_radius, 0.0), 2.2 * p.pivot_radius)
    return inward, 1.6 * p.pivot_radius - 0.4 * inward


def _axle(name: str, at: tuple[float, float, float], radius: float, width: float) -> Part:
    x, y, z = at
    return cylinder(name, (x, y - width / 2, z), (x, y + width / 2, z), radius)


def _carriage(p: FamilyParameters) -> Part:
    half, width = _carriage_half(p), 0.6 * max(p.finger_width, 0.02)
    return box("carriage", (-half, -width, 0.0005), (half, width, p.carriage_height))


def _blade(p: FamilyParameters, face: float, foot: float, tip: float) -> list[Part]:
    """Return beam, back plate and pad of a finger whose pad's face lies at X = face."""
    back = face - p.pad_thickness
    thin = p.taper * p.finger_thickness
    heel = tip - p.pad_length
    w, root = p.finger_width / 2, p.finger_thickness / 2
    foot_w = min(w, 0.8 * w + 0.004)
    parts = []
    if heel > foot + 0.002:
        bottom = [(x, y, foot) for x in (-root, root) for y in (-foot_w, foot_w)]
        top = [
            (x, y, z) for x in (back - thin, back) for y in (-w, w) for z in (heel, heel + 0.003)
        ]
        parts.append(hull("beam", bottom + top))
    plate = _chamfered(w, max(heel, foot), tip)
    parts.append(prism("plate", plate, 0, back - thin, back))
    return parts + _pads(p, back, face, heel, tip)


def _pads(p: FamilyParameters, back: float, face: float, low: float, high: float) -> list[Part]:
    """Return the pad between the back plate and X = face, with the shape of its kind."""
    w, middle = p.finger_width / 2, (low + high) / 2
    arc = np.linspace(-1.0, 1.0, ARC_POINTS)
    bulge = back + (face - back) * np.sqrt(1.0 - 0.85 * arc**2)
    if p.pad == "rounded":
        outline = [(back, low), *zip(bulge, middle + arc * (high - low) / 2), (back, high)]
        return [prism("pad", outline, 1, -w, w)]
    if p.pad == "barrel":
        outline = [(back, -w), *zip(bulge, arc * w), (back, w)]
        return [prism("pad", outline, 2, low, high)]
    if p.pad == "domed":
        return [ellipsoid("pad", (back, 0.0, middle), (face - back, w, (high - low) / 2))]
    if p.pad == "vee":
        floor = face - 0.6 * (face - back)
        half = np.array([(back, 0.0), (floor, 0.0), (face, 0.85 * w), (face, w), (back, w)])
        return [
            prism("pad_a", half, 2, low, high),
            prism("pad_b", half * [1.0, -1.0], 2, low, high),
        ]
    return [prism("pad", _chamfered(0.96 * w, low, high - 0.0005), 0, back, face)]


def _chamfered(w: float, low: float, high: float) -> list[tuple[float, float]]:
    """Return the outline in YZ of a plate with its upper corners cut."""
    cut = min(CHAMFER * 2 * w, (high - low) / 2) * math.sqrt(2)
    return [
        (-w, low),
        (w, low),
        (w, high - cut),
        (w - cut, high),
        (cut - w, high),
        (-w, high - cut),
    ]

"""Kinds of procedural objects: each draws its own sizes and returns a solid.

Sizes suit picking with jaws that open 50 to 100 mm: but for the obstacles, every kind has a width
of 15 to 70 mm somewhere and no edge over 0.18 m. Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .solids import Solid, blocks, box, ellipsoid, prism, shell, stack

Rng = np.random.Generator
Kind = Callable[[Rng], Solid]

OBJECT_KINDS: dict[str, Kind] = {}
OBSTACLE_KINDS: dict[str, Kind] = {}


def object_kind(registry: dict[str, Kind]) -> Callable[[Kind], Kind]:
    """Return a decorator that enters a kind, a function of a random generator, under its name."""

    def enter(kind: Kind) -> Kind:
        registry[kind.__name__.removeprefix("make_")] = kind
        return kind

    return enter


@object_kind(OBJECT_KINDS)
def make_box(rng: Rng) -> Solid:
    """A carton: one edge to grasp, the others up to 0.18 m."""
    return box([rng.uniform(0.018, 0.065), rng.uniform(0.03, 0.11), rng.uniform(0.04, 0.18)])


@object_kind(OBJECT_KINDS)
def make_block(rng: Rng) -> Solid:
    """A small block, graspable along at least two edges."""
    return box(rng.uniform(0.016, 0.06, 3).tolist())


@object_kind(OBJECT_KINDS)
def make_cylinder(rng: Rng) -> Solid:
    """A can or a rod."""
    radius = rng.uniform(0.009, 0.034)
    height = rng.uniform(0.02, 0.16)
    return stack([(radius, -height / 2), (radius, height / 2)])


@object_kind(OBJECT_KINDS)
def make_prism(rng: Rng) -> Solid:
    """A bar with three to eight sides, such as a nut or a pencil."""
    sides = int(rng.integers(3, 9))
    radius = rng.uniform(0.012, 0.034)
    angle = np.arange(sides) * (2 * np.pi / sides)
    outline = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return prism(outline, rng.uniform(0.02, 0.15))


@object_kind(OBJECT_KINDS)
def make_ellipsoid(rng: Rng) -> Solid:
    """A ball, egg or fruit."""
    return ellipsoid(
        [rng.uniform(0.014, 0.034), rng.uniform(0.014, 0.034), rng.uniform(0.014, 0.055)]
    )


@object_kind(OBJECT_KINDS)
def make_tube(rng: Rng) -> Solid:
    """A length of pipe."""
    radius = rng.uniform(0.012, 0.034)
    wall = rng.uniform(0.003, 0.008)
    half = rng.uniform(0.02, 0.16) / 2
    return _pipe(radius, max(0.004, radius - wall), half)


@object_kind(OBJECT_KINDS)
def make_tape_roll(rng: Rng) -> Solid:
    """A flat ring, to be grasped by its wall or across."""
    inner = rng.uniform(0.018, 0.038)
    wall = rng.uniform(0.006, 0.016)
    return _pipe(inner + wall, inner, rng.uniform(0.014, 0.05) / 2)


@object_kind(OBJECT_KINDS)
def make_bottle(rng: Rng) -> Solid:
    """Body, shoulder, neck, sometimes a cap that juts out."""
    body = rng.uniform(0.016, 0.034)
    neck = body * rng.uniform(0.3, 0.65)
    low = rng.uniform(0.03, 0.10)
    shoulder = low + rng.uniform(0.004, 0.03)
    top = shoulder + rng.uniform(0.008, 0.03)
    profile = [(body, 0.0), (body, low), (neck, shoulder), (neck, top)]
    if rng.random() < 0.5:
        cap = neck * rng.uniform(1.1, 1.4)
        profile += [(cap, top), (cap, top + rng.uniform(0.008, 0.018))]
    return stack(profile)


@object_kind(OBJECT_KINDS)
def make_screwdriver(rng: Rng) -> Solid:
    """A thick handle and a thin shaft."""
    handle, shaft = rng.uniform(0.010, 0.018), rng.uniform(0.004, 0.007)
    grip = rng.uniform(0.05, 0.09)
    return stack(
        [(handle, 0.0), (handle, grip), (shaft, grip), (shaft, grip + rng.uniform(0.04, 0.09))], 24
    )


@object_kind(OBJECT_KINDS)
def make_spool(rng: Rng) -> Solid:
    """Two flanges on a core: a dumb-bell, a bobbin, a knob."""
    core = rng.uniform(0.006, 0.02)
    first, second = core + rng.uniform(0.005, 0.014), core + rng.uniform(0.005, 0.014)
    a = rng.uniform(0.006, 0.025)
    b = a + rng.uniform(0.02, 0.08)
    c = b + rng.uniform(0.006, 0.025)
    return stack([(first, 0.0), (first, a), (core, a), (core, b), (second, b), (second, c)], 24)


@object_kind(OBJECT_KINDS)
def make_l_bracket(rng: Rng) -> Solid:
    """Two legs at a right angle."""
    wall = rng.uniform(0.008, 0.022)
    xs = [0.0, wall, wall + rng.uniform(0.02, 0.09)]
    ys = [0.0, wall, wall + rng.uniform(0.02, 0.09)]
    return blocks(xs, ys, [0.0, rng.uniform(0.018, 0.06)], _pattern(["#.", "##"]))


@object_kind(OBJECT_KINDS)
def make_t_bracket(rng: Rng) -> Solid:
    """A bar with a stem."""
    wall = rng.uniform(0.010, 0.025)
    left = rng.uniform(0.012, 0.05)
    xs = [0.0, left, left + wall, left + wall + rng.uniform(0.012, 0.05)]
    ys = [0.0, rng.uniform(0.02, 0.08)]
    ys.append(ys[1] + rng.uniform(0.010, 0.025))
    return blocks(xs, ys, [0.0, rng.uniform(0.015, 0.06)], _pattern(["###", ".#."]))


@object_kind(OBJECT_KINDS)
def make_channel(rng: Rng) -> Solid:
    """A U profile: a base and two flanges."""
    wall = rng.uniform(0.005, 0.012)
    inside = rng.uniform(0.015, 0.045)
    xs = [0.0, wall, wall + inside, 2 * wall + inside]
    ys = [0.0, wall, wall + rng.uniform(0.012, 0.045)]
    return blocks(xs, ys, [0.0, rng.uniform(0.02, 0.13)], _pattern(["#.#", "###"]))


@object_kind(OBJECT_KINDS)
def make_cross(rng: Rng) -> Solid:
    """A plus with four arms."""
    a, b = rng.uniform(0.012, 0.04, 2), rng.uniform(0.012, 0.04, 2)
    core = rng.uniform(0.012, 0.03, 2)
    xs = [0.0, a[0], a[0] + core[0], a[0] + core[0] + a[1]]
    ys = [0.0, b[0], b[0] + core[1], b[0] + core[1] + b[1]]
    return blocks(xs, ys, [0.0, rng.uniform(0.015, 0.05)], _pattern([".#.", "###", ".#."]))


@object_kind(OBJECT_KINDS)
def make_bowl(rng: Rng) -> Solid:
    """An open bowl or cup: a bottom and a wall in two rings, to be grasped by the rim."""
    rim = rng.uniform(0.028, 0.065)
    height = rng.uniform(0.03, 0.075)
    base = rim * rng.uniform(0.5, 0.95)
    wall = rng.uniform(0.003, 0.006)
    bulge = rng.uniform(0.4, 0.9)
    middle = base + (rim - base) * bulge
    outer = [(base, 0.0), (middle, height * 0.45), (rim, height)]
    inner = [(base - wall, wall), (middle - wall, height * 0.45), (rim - wall, height)]
    return shell(outer, inner, 12, floor=True)


@object_kind(OBSTACLE_KINDS)
def make_crate(rng: Rng) -> Solid:
    """A carton too wide for the jaws in every direction."""
    return box(rng.uniform(0.09, 0.17, 3).tolist())


@object_kind(OBSTACLE_KINDS)
def make_drum(rng: Rng) -> Solid:
    """A short, wide cylinder."""
    radius, half = rng.uniform(0.055, 0.085), rng.uniform(0.09, 0.15) / 2
    return stack([(radius, -half), (radius, half)])


@object_kind(OBSTACLE_KINDS)
def make_dome(rng: Rng) -> Solid:
    """A big ball or loaf."""
    return ellipsoid(rng.uniform(0.05, 0.08, 3).tolist())


def _pipe(outer: float, inner: float, half: float) -> Solid:
    return shell([(outer, -half), (outer, half)], [(inner, -half), (inner, half)], 16, floor=False)


def _pattern(rows: list[str]) -> np.ndarray:
    """Return the cells (x, y, 1) of a drawing whose first row is the greatest y."""
    grid = np.array([[mark == "#" for mark in row] for row in reversed(rows)])
    return grid.T[:, :, None]

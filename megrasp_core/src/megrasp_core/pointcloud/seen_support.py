"""Whether a cloud shows what its objects lie on, or only the tops of flat objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from .floor_grid import footprint, grid_on, plane_axes
from .plane import Plane, PlaneSettings, support_plane
from .scene import SurfaceCloud

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

COARSE = 0.005
"""Distance (m) of the places that a support is looked for at."""
HOLES = 0.15
"""A support shows no readings in at most this share of what is in view of it."""
MARGIN = 0.008
"""What is nearer to a support (m) may be part of it."""
HIGHEST = 0.15
"""An object's top may be so high (m) over what it stands on, and be taken for a support."""
STRAY = 0.02
"""Share of the points that may lie below a support; sides of a flat object lie below its top."""
SMALLEST = 0.01
"""Area (m2) of the smallest support."""
TOLERANCE = 0.010
"""A floor that is known to this (m) was seen where the depth agrees."""
MOST_TILTED = 0.6
"""A chute that is seen whole may be as steep as this (rad)."""
MOSTLY = 0.5
"""A tilted support is more than this share of what is seen; less of the rest lies beside one."""


def shows_support(surface: SurfaceCloud) -> bool:
    """Whether a plane carries the rest: the level one that was found, or one that is tilted."""
    gravity = surface.gravity
    assert gravity is not None
    if surface.on_plane.any():
        height = float(np.median(surface.points[surface.on_plane] @ -gravity))
        return _carries(surface, surface.on_plane, Plane(-gravity, height))
    tilted = support_plane(surface.points, None, normals=surface.normals, sensor=surface.sensor)
    if tilted is None or tilted.normal @ -gravity < np.cos(MOST_TILTED):
        return False
    on_plane = np.abs(tilted.height(surface.points)) < PlaneSettings().band
    return bool(on_plane.mean() > MOSTLY) and _carries(surface, on_plane, tilted)


def _carries(surface: SurfaceCloud, on_plane: BoolArray, plane: Plane) -> bool:
    """Whether the rest lies on the plane, and it is seen between what lies there.

    The level top of a flat object carries nothing: its sides are below it, others stand beside
    it. The tops of several carry none either: past them nothing is seen at that height.
    """
    height = plane.height(surface.points)
    if ((height < -MARGIN) & (height > -HIGHEST)).mean() > STRAY:
        return False
    axes = plane_axes(plane.normal)
    flat = surface.points @ axes.T
    rest = flat[~on_plane]
    try:
        hull = ConvexHull(flat[on_plane])
    except QhullError:
        return False
    if hull.volume < SMALLEST:  # in two dimensions the area
        return False
    sides = hull.equations

    def beside(points: FloatArray) -> BoolArray:
        return (points @ sides[:, :2].T + sides[:, 2]).max(axis=1, initial=-np.inf) > 0.0

    if len(rest) and beside(rest).mean() >= MOSTLY:
        return False
    between = grid_on(plane, footprint(surface, plane), COARSE)
    between = between[~beside(between @ axes.T)]
    looks = [view.image.lookup(between) for view in surface.views]
    seen = np.logical_or.reduce(
        [np.isfinite(front) & (front >= depth - TOLERANCE) for depth, front, _ in looks]
    )
    empty = np.logical_or.reduce([~np.isfinite(front) for _, front, _ in looks]) & ~seen
    return bool(empty.sum() <= HOLES * (empty.sum() + seen.sum()))

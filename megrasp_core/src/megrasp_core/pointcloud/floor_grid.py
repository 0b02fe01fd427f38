"""Points on planes: where a floor, or a wall, may be looked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .plane import Plane
from .scene import SurfaceCloud

FloatArray = NDArray[np.float64]

MOST = 1_000_000
"""Points that are put in on a floor or a wall; on larger ones they lie further apart."""
BEYOND = 0.10
"""A floor without a region reaches so far beyond what was seen (m)."""


def plane_axes(normal: FloatArray) -> FloatArray:
    """(2, 3) orthonormal, in the plane of a normal."""
    first = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def footprint(surface: SurfaceCloud, floor: Plane) -> FloatArray:
    """The rectangle of floor in the region, or below and around what was seen, as a corner, the
    two edges from it, and the normal, (4, 3).
    """
    region = surface.region
    if region is not None:
        axis, _ = region.face_towards(floor.normal)
        first, second = (
            region.rotation[:, (axis + k) % 3] * region.size[(axis + k) % 3] for k in (1, 2)
        )
        corner = region.centre - (first + second) / 2
    else:
        axes = plane_axes(floor.normal)
        flat = surface.points @ axes.T
        low, high = np.percentile(flat, (0.5, 99.5), axis=0)
        low, high = low - BEYOND, high + BEYOND
        first, second = axes * (high - low)[:, None]
        corner = low @ axes
    return np.stack([corner, first, second, floor.normal])


def grid_on(floor: Plane, rectangle: FloatArray, step: float) -> FloatArray:
    """Points (P, 3) on the floor.

    Args:
        floor: the plane.
        rectangle: (4, 3) of `footprint`; the points lie over it along its normal.
        step: distance between them (m).
    """
    corner, first, second, normal = rectangle
    points = patch(corner, first, second, step)
    return points - floor.height(points)[:, None] * normal


def patch(corner: FloatArray, first: FloatArray, second: FloatArray, step: float) -> FloatArray:
    """Points (P, 3) on a parallelogram, not more than about `MOST`.

    Args:
        corner: (3,) of it.
        first: (3,) edge from the corner.
        second: (3,) the other edge.
        step: distance between the points (m); more on a large one.
    """
    lengths = [float(np.linalg.norm(edge)) for edge in (first, second)]
    # A region may be as large as a hall.
    step = max(step, float(np.sqrt(lengths[0] * lengths[1] / MOST)), max(lengths) / MOST)
    counts = [max(2, int(np.ceil(length / step))) for length in lengths]
    u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts), indexing="ij")
    return corner + u.reshape(-1, 1) * first + v.reshape(-1, 1) * second

"""Pixels of a gripper seen along one direction: the open surface, where it closes to, what it
sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.grippers import GripperClouds
from megrasp_core.meshes import Mesh, RayScene

from .closing_motion import STILL, ClosingMotion
from .splat import Projection

__all__ = [
    "CLOSED",
    "CLOSED_ALPHA",
    "OPEN",
    "SWEPT",
    "SWEPT_ALPHA",
    "raster",
    "reduced",
    "solid",
]

OPEN = np.array([0.62, 0.68, 0.78])
CLOSED = np.array([0.95, 0.55, 0.15])
SWEPT = np.array([0.35, 0.75, 0.68])
SWEPT_ALPHA, CLOSED_ALPHA, HIDDEN_ALPHA = 0.35, 0.62, 0.22
SHARPNESS = 2
"""Rays a pixel, in either direction."""
STAND_OFF = 2.0
"""Distance from the middle of the view to where the rays start (m)."""
SMOOTH = 8
CREASE = 0.8
"""Neighbouring normals whose product is smaller have an edge between them."""
DEPTH_STEP = 0.002
"""Neighbouring depths that differ by more have an edge between them (m); surfaces seen at a
slant in a small picture need more.
"""
ON_SURFACE = 1e-3
"""A point this little behind what is seen (m) is seen."""
DOT = 1


def raster(motion: ClosingMotion, clouds: GripperClouds, view: Projection) -> NDArray[np.float64]:
    """Return the picture (H, W, 3), 0..1, of a motion: the open gripper solid, the closed fingers
    and the swept region translucent, points of the clouds that are seen as dots.
    """
    surface, depth = solid(motion.meshes, view, OPEN)
    image = np.ones((*depth.shape, 3))
    _blend(image, _smooth(np.isfinite(_depths(motion.swept, view)[0])), SWEPT, SWEPT_ALPHA)
    seen = np.isfinite(depth)
    image[seen] = surface[seen]
    _dots(image, clouds.open_points, depth, view, 0.4 * OPEN)
    closed, normals = _depths(motion.closed, view)
    mask = np.isfinite(closed)
    tint = CLOSED * (0.75 + 0.35 * _light(normals, view)[..., None])
    front = closed < depth + 1e-4
    _blend(image, mask & front, tint, CLOSED_ALPHA)
    _blend(image, mask & ~front, tint, HIDDEN_ALPHA)
    _blend(image, _outline(mask), 0.7 * CLOSED, 0.9)
    moved = np.linalg.norm(clouds.closed_displacement, axis=1) > STILL
    _dots(image, clouds.closed_points[moved], closed, view, 0.5 * CLOSED)
    return reduced(image)


def reduced(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the picture (H, W, 3), 0..1, of rays (SHARPNESS H, SHARPNESS W, 3)."""
    height, width, _ = image.shape
    blocks = image.reshape(height // SHARPNESS, SHARPNESS, width // SHARPNESS, SHARPNESS, 3)
    return np.clip(blocks.mean(axis=(1, 3)), 0.0, 1.0)


def _dots(
    image: NDArray[np.float64],
    points: NDArray[np.float64],
    depth: NDArray[np.float64],
    view: Projection,
    colour: NDArray[np.float64],
) -> None:
    """Paint the points (N, 3) that lie on the surface of this depth (H, W), in place."""
    local = view.project(points)
    column, row = np.floor(SHARPNESS * local[:, :2].T).astype(np.int64)
    inside = (column > 0) & (row > 0) & (column < depth.shape[1]) & (row < depth.shape[0])
    column, row, away = column[inside], row[inside], local[inside, 2] + STAND_OFF
    seen = away < depth[row, column] + ON_SURFACE
    mask = np.zeros(depth.shape, bool)
    mask[row[seen], column[seen]] = True
    grown = np.asarray(ndimage.binary_dilation(mask, iterations=DOT), dtype=bool)
    _blend(image, grown, colour, 0.8)


def solid(
    meshes: Sequence[Mesh],
    view: Projection,
    paint: NDArray[np.float64],
    step: float = DEPTH_STEP,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return colour (H, W, 3) and depth (H, W), infinite where nothing is, of the rays on a lit
    surface painted (3,), with its edges drawn; SHARPNESS rays a pixel in either direction.

    Neighbouring depths that differ by more than `step` (m) have an edge between them.
    """
    depth, normals = _depths(meshes, view)
    colour = paint * (0.55 + 0.55 * _light(normals, view)[..., None])
    known = np.where(np.isfinite(depth), depth, 1.0)
    jump = ndimage.maximum_filter(known, 3) - ndimage.minimum_filter(known, 3) > step
    right = (normals * np.roll(normals, -1, axis=1)).sum(axis=-1) < CREASE
    below = (normals * np.roll(normals, -1, axis=0)).sum(axis=-1) < CREASE
    _blend(colour, right | below, 0.45 * paint, 0.5)
    _blend(colour, jump, 0.35 * paint, 0.9)
    return colour, depth


def _depths(
    meshes: Sequence[Mesh], view: Projection
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return depth (H, W), infinite where nothing is, and normals (H, W, 3) towards the viewer."""
    width, height = (SHARPNESS * n for n in view.size)
    if not meshes:
        return np.full((height, width), np.inf), np.zeros((height, width, 3))
    u = ((np.arange(width) + 0.5) / SHARPNESS - view.size[0] / 2) / view.scale
    v = ((np.arange(height) + 0.5) / SHARPNESS - view.size[1] / 2) / view.scale
    right, down, forward = view.rotation
    start = view.centre - STAND_OFF * forward + u[None, :, None] * right + v[:, None, None] * down
    rays = np.concatenate([start, np.broadcast_to(forward, start.shape)], axis=-1)
    hits = RayScene(meshes).cast(rays)
    normals = hits.normals.astype(np.float64)
    normals *= -np.sign(normals @ forward)[..., None]
    return hits.distance.astype(np.float64), normals


def _light(normals: NDArray[np.float64], view: Projection) -> NDArray[np.float64]:
    """Return the brightness (H, W), 0..1, of surfaces lit from the viewer's upper left."""
    direction = np.array([-0.45, -0.6, -0.75]) @ view.rotation
    return np.clip(normals @ (direction / np.linalg.norm(direction)), 0.0, 1.0)


def _outline(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return mask & ~np.asarray(ndimage.binary_erosion(mask, iterations=SHARPNESS), dtype=bool)


def _smooth(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill narrow notches: links stand a few pixels apart from step to step, which would scallop
    their common outline.
    """
    filled = ndimage.binary_closing(np.pad(mask, SMOOTH), iterations=SMOOTH)
    return np.asarray(filled, dtype=bool)[SMOOTH:-SMOOTH, SMOOTH:-SMOOTH]


def _blend(
    image: NDArray[np.float64], where: NDArray[np.bool_], colour: NDArray[np.float64], alpha: float
) -> None:
    """Lay a colour (3,) or (H, W, 3) over the pixels `where`, in place."""
    paint = np.broadcast_to(colour, image.shape)
    image[where] = (1.0 - alpha) * image[where] + alpha * paint[where]

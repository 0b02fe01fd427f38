"""What lies under seen surfaces, away from their outlines: the bodies whose tops they are."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

__all__ = ["SurfaceCover"]

CELL = 0.004
"""Least width of a cell of the height map (m)."""
MAX_SIDE = 2048
"""Cells along a side of the height map; larger scenes have no cover."""
SAMPLE = 20_000
"""Points that the extent is taken from, but for a thousandth at either end: strays."""
FILLED_BY = 5
"""An empty cell with so many of its eight neighbours is a gap between points."""


class SurfaceCover:
    """Height along gravity below which every place lies under a seen surface that goes on for
    some way all around it.

    A camera over a bin sees tops. What is deeper below one than the shell of a body may be the
    body still, or the space under an overhang; well within the outline of the top it is nearly
    always the body.
    """

    def __init__(self, points: np.ndarray, down: np.ndarray, inset: float, spacing: float) -> None:
        """Draw the height map of a cloud.

        Args:
            points: (K, 3) what was seen (m).
            down: (3,) unit vector, along gravity.
            inset: a surface covers only what is at least so far (m) within its outline.
            spacing: of the points (m); cells are wide enough to hold some.
        """
        up = -np.asarray(down, dtype=np.float64)
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
        x /= np.linalg.norm(x)
        self._axes = np.stack([x, np.cross(up, x), up]).astype(np.float32)
        self._origin = np.median(np.asarray(points)[:: max(1, len(points) // SAMPLE)], axis=0)
        self._cell = np.float32(max(CELL, 1.5 * spacing))
        local = self._local(points)
        some = local[:: max(1, len(local) // SAMPLE), :2]
        low, high = np.quantile(some, (0.001, 0.999), axis=0)
        self._corner = (low - 0.05 * (high - low) - self._cell).astype(np.float32)
        shape = np.ceil(1.1 * (high - low) / self._cell).astype(np.int64) + 3
        if shape.max() > MAX_SIDE:
            shape = np.zeros(2, dtype=np.int64)
        heights = np.full(shape, -np.inf, dtype=np.float32)
        cells = self._cells(local)
        inside = ((cells >= 0) & (cells < shape)).all(axis=1)
        np.maximum.at(heights, tuple(cells[inside].T), local[inside, 2])
        reach = max(1, round(inset / float(self._cell)))
        self._heights = _inset(_filled(heights), reach) if heights.size else heights

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How far (P,) points (P, 3) lie below the cover (m, float32); -inf where there is
        none.
        """
        local = self._local(points)
        cells = self._cells(local)
        inside = ((cells >= 0) & (cells < self._heights.shape)).all(axis=1)
        depth = np.full(len(local), -np.inf, dtype=np.float32)
        row, column = cells[inside].T
        depth[inside] = self._heights[row, column] - local[inside, 2]
        return depth

    def _local(self, points: np.ndarray) -> np.ndarray:
        # The difference is taken in the precision that is given: float64 far from the origin.
        points = np.asarray(points)
        offset = points - self._origin.astype(points.dtype)
        return offset.astype(np.float32, copy=False) @ self._axes.T

    def _cells(self, local: np.ndarray) -> np.ndarray:
        return np.floor((local[:, :2] - self._corner) / self._cell).astype(np.int64)


def _filled(heights: np.ndarray) -> np.ndarray:
    """Gaps get the lowest height beside them."""
    empty = ~np.isfinite(heights)
    beside = ndimage.uniform_filter((~empty).astype(np.float32), size=3, mode="constant") * 9
    lowest = ndimage.minimum_filter(np.where(empty, np.inf, heights), size=3)
    return np.where(empty & (beside > FILLED_BY - 0.5), lowest, heights)


def _inset(heights: np.ndarray, cells: int) -> np.ndarray:
    """The lowest height within a disc of this radius in cells."""
    steps = np.arange(-cells, cells + 1)
    disc = steps[:, None] ** 2 + steps**2 <= (cells + 0.5) ** 2
    return ndimage.minimum_filter(heights, footprint=disc, mode="constant", cval=-np.inf)

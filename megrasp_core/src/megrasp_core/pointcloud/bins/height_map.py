"""The scene from above: the highest point of every cell of a level grid, and its edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .settings import BinSettings

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

DIRECTIONS = 16
"""Edges are looked for in so many directions."""
MAX_CELLS = 400_000
REACH = 5
"""Cells around an edge that are looked at."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Highest points of a grid.

    Attributes:
        low: (2,) coordinates of the corner of cell (0, 0) (m).
        cell: edge of a cell (m).
        top: (rows, columns) highest z (m); NaN where nothing was seen.
        noise: typical difference of height between neighbours on a surface (m).
    """

    low: FloatArray
    cell: float
    top: FloatArray
    noise: float

    def sample(self, xy: FloatArray) -> FloatArray:
        """Height (N,) at places (N, 2); NaN where nothing was seen or outside."""
        index = np.floor((xy - self.low) / self.cell).astype(np.intp)
        inside = np.all((index >= 0) & (index < self.top.shape), axis=-1)
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.top[index[..., 0], index[..., 1]], np.nan)


@dataclass(frozen=True, eq=False)
class Edges:
    """Cells from which the surface falls.

    Attributes:
        places: (K, 3) middle of the cell and its height (m).
        falls: (K, 16) whether it falls in the direction of angle k * 22.5 degrees: 1 where the
            lower surface is seen, a little less where nothing is seen there, 0 where it does not.
        drop: how far it falls at least (m).
    """

    places: FloatArray
    falls: NDArray[np.float32]
    drop: float


def height_map(points: FloatArray, settings: BinSettings) -> HeightMap | None:
    """The map of points (N, 3) with z up; None where they cover less than a bin."""
    low, high = np.percentile(points[:: max(1, len(points) // 20_000)], [0.2, 99.8], axis=0)
    low, high = low - 0.02, high + 0.02
    inside = ((points[:, :2] >= low[:2]) & (points[:, :2] < high[:2])).all(axis=1)
    points = points[inside]
    extent = high[:2] - low[:2]
    if len(points) < 100 or extent.min() < settings.shortest:
        return None
    cell = max(settings.cell, float(np.sqrt(extent.prod() / MAX_CELLS)))
    for _ in range(4):
        shape = (np.ceil(extent / cell)).astype(int) + 1
        index = ((points[:, :2] - low[:2]) * (1.0 / cell)).astype(np.intp)
        key = index[:, 0] * shape[1] + index[:, 1]
        occupied = np.count_nonzero(np.bincount(key))
        if len(points) >= 2.0 * occupied:
            break
        cell *= 1.5
    top = np.full(int(shape.prod()), -np.inf)
    np.maximum.at(top, key, points[:, 2])
    top[np.isinf(top)] = np.nan
    top = top.reshape(shape)
    step = np.abs(np.diff(top, axis=0))
    step = step[np.isfinite(step)]
    noise = float(np.median(step)) if len(step) else 0.0
    return HeightMap(low[:2], cell, top, noise)


def edges(map: HeightMap, settings: BinSettings) -> Edges:
    """Where and in which directions the surface of a map falls."""
    drop = max(settings.drop, 5.0 * map.noise)
    padded = np.pad(map.top, REACH, constant_values=np.nan)
    known = np.isfinite(padded)
    # Most cells are far from any edge: leave them out before looking in all directions.
    lowest = ndimage.minimum_filter(np.where(known, padded, np.inf), 2 * REACH - 1)
    gaps = ndimage.minimum_filter(known, 2 * REACH - 1) == 0
    rows, columns = np.nonzero(known & ((padded - lowest > drop) | gaps))
    within = (rows >= REACH) & (rows < padded.shape[0] - REACH)
    within &= (columns >= REACH) & (columns < padded.shape[1] - REACH)
    rows, columns = rows[within], columns[within]
    height = padded[rows, columns]
    # Where something hides a table the table ends, and that is no edge.
    support = np.abs(height - _main_level(map)) < max(0.006, 4.0 * map.noise)
    falls = np.zeros((len(rows), DIRECTIONS), np.float32)
    for k in range(DIRECTIONS):
        angle = 2 * np.pi * k / DIRECTIONS
        step = np.array([np.cos(angle), np.sin(angle)])
        at = [
            padded[rows + round(r * step[0]), columns + round(r * step[1])]
            for r in (-2, -1, 1, 2, 3, 4)
        ]
        higher = (at[0] > height + 0.5 * drop) | (at[1] > height + 0.5 * drop)
        low = [value < height - drop for value in at[2:]]
        high = [value >= height - drop for value in at[2:]]
        steep = (low[0] | low[1] | low[2] | low[3]) & ~(high[1] | high[2] | high[3])
        open_ = ~np.isfinite(at[3]) & ~np.isfinite(at[4]) & ~np.isfinite(at[5])
        open_ &= ~support
        falls[:, k] = np.where(higher, 0.0, np.where(steep, 1.0, np.where(open_, 0.7, 0.0)))
    some = falls.any(axis=1)
    rows, columns, falls = rows[some], columns[some], falls[some]
    xy = map.low + (np.column_stack([rows, columns]) - REACH + 0.5) * map.cell
    return Edges(np.column_stack([xy, padded[rows, columns]]), falls, drop)


def _main_level(map: HeightMap) -> float:
    """Height (m) at which most is seen, that of a table; infinite where no height stands out."""
    heights = np.sort(map.top[np.isfinite(map.top)])
    band = max(0.006, 4.0 * map.noise)
    many = np.searchsorted(heights, heights + band) - np.arange(len(heights))
    best = int(np.argmax(many))
    if many[best] < 0.1 * len(heights):
        return float("inf")
    return float(np.median(heights[best : best + many[best]]))

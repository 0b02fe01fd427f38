"""What is in a bin: how deep it is, how full, and whether it is empty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.pointcloud.box import OrientedBox
from megrasp_core.pointcloud.emptiness import (
    MIN_HEIGHT,
    MIN_VOXELS,
    VOXEL,
    WALL_STRIP,
    only_support_left,
)
from megrasp_core.pointcloud.voxels import voxel_means

from .found import DepthFrom
from .rim import Rim
from .settings import BinSettings

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GRID = 0.006
"""Heights are averaged in squares of this edge (m)."""
AROUND = 0.10
"""So far from the walls the bin's surroundings are looked at (m)."""
FLOOR_SHARE = 0.02
"""Least share of the squares that makes a floor."""
SURE_SHARE = 0.3
"""So much of it is a floor whatever the surroundings say."""
FLOOR_THICKNESS = 0.003
"""Assumed where only the surroundings are seen (m)."""
FLOOR_SLACK = 0.015
AIR = 0.010
"""Edge of the cubes in which points in the air are told from surfaces by their number (m)."""


def depth_of(
    inside: FloatArray, around: FloatArray, rim: Rim, noise: float, settings: BinSettings
) -> tuple[float, DepthFrom]:
    """Depth (m) below the rim, and what it was taken from.

    Args:
        inside: (N, 3) points between the walls, in the rim's frame.
        around: (N, 3) level points near the bin and outside of it.
        rim: of the bin.
        noise: of the heights (m).
        settings: limits.
    """
    stands = _height_over(around, rim)
    squares = _flat_squares(inside, rim)
    heights = np.sort(squares)
    floor = float("nan")
    if len(heights):
        band = max(0.006, 4.0 * noise)
        many = np.searchsorted(heights, heights + band) - np.arange(len(heights))
        below = np.arange(len(heights))
        enough = max(6.0, FLOOR_SHARE * len(heights))
        good = np.flatnonzero((many >= enough) & (below <= 0.015 * len(heights) + 2))
        if len(good):
            start = good[int(np.argmax(many[good]))]
            level = heights[start : start + many[start]]
            floor = -float(np.median(level))
            share = many[start] * GRID**2 / (4 * rim.half.prod())
            # The flat top of something is no floor.
            if np.isfinite(stands) and floor < stands - FLOOR_SLACK and share < SURE_SHARE:
                floor = float("nan")
    if np.isfinite(floor) and floor >= settings.shallowest:
        return floor, "floor"
    if np.isfinite(stands) and stands >= settings.shallowest:
        return stands, "surroundings"
    lowest = -float(np.percentile(inside[:, 2], 1)) if len(inside) else float("nan")
    return lowest, "lowest point"


def _flat_squares(inside: FloatArray, rim: Rim) -> FloatArray:
    """Height (K,) of the squares that see one flat level."""
    inset = rim.half - WALL_STRIP
    on = (np.abs(inside[:, :2]) < inset).all(axis=1)
    x, y, z = inside[on].T
    columns, rows = (int(2 * edge / GRID) + 1 for edge in inset)
    key = ((x + inset[0]) / GRID).astype(np.intp) * rows + ((y + inset[1]) / GRID).astype(np.intp)
    count = np.bincount(key, minlength=columns * rows)
    some = count >= 3
    mean = np.bincount(key, z, columns * rows)[some] / count[some]
    square = np.bincount(key, z**2, columns * rows)[some] / count[some]
    spread = np.sqrt(np.maximum(square - mean**2, 0))
    typical = float(np.median(spread)) if len(spread) else 0.0
    return mean[spread < max(0.003, 2 * typical)]


def _height_over(around: FloatArray, rim: Rim) -> float:
    """Height of the lowest corner of the rim over the surroundings, along the walls, less a floor;
    NaN where the surroundings show no level.
    """
    if len(around) < 200:
        return float("nan")
    levels = np.sort(around[:, 2])
    many = np.searchsorted(levels, levels + 0.008) - np.arange(len(levels))
    best = int(np.argmax(many))
    if many[best] < 0.15 * len(levels):
        return float("nan")
    table = float(np.median(levels[best : best + many[best]]))
    corners = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]) * [*rim.half, 0.0]
    rotation, origin = rim.level_from_rim[:3, :3], rim.level_from_rim[:3, 3]
    lowest = float((corners @ rotation.T + origin)[:, 2].min())
    return (lowest - table) / float(rotation[2, 2]) - FLOOR_THICKNESS


def fill(
    inside: FloatArray,
    near: FloatArray,
    box: OrientedBox,
    sensor: FloatArray | None,
    settings: BinSettings,
) -> tuple[FloatArray, float]:
    """Share of the depth up to which each cell is full (rows, columns), see `FoundBin`, and of the
    whole, 0..1.

    Args:
        inside: (N, 3) points between the walls, in the frame of the box.
        near: (M, 3) these and all others that may hide them, in the frame of the box.
        box: whose inside it is.
        sensor: (3,) in the frame of the box; None: several places.
        settings: size of the cells.
    """
    columns, rows = (max(1, round(edge / settings.fill_cell)) for edge in box.size[:2])
    # A whole number of squares a cell.
    fine = [max(1, round(box.size[i] / n / GRID)) * n for i, n in ((0, columns), (1, rows))]
    height = _mean_heights(inside, box, fine)
    if sensor is not None and sensor[2] > box.size[2] / 2:
        height[np.isnan(height) & ~_hidden(near, box, sensor, fine)] = 0.0
    # What is hidden lies lower than what hides it.
    lowest = ndimage.minimum_filter(np.where(np.isfinite(height), height, np.inf), 7)
    hidden = np.isnan(height) & np.isfinite(lowest)
    height[hidden] = lowest[hidden]
    blocks = height.reshape(columns, fine[0] // columns, rows, fine[1] // rows)
    seen = np.isfinite(blocks)
    count = seen.sum(axis=(1, 3))
    total = np.where(seen, blocks, 0.0).sum(axis=(1, 3))
    cells = np.where(count > 0, total / np.maximum(count, 1), np.nan).T / box.size[2]
    cells = np.maximum(cells, 0.0)
    known = np.isfinite(cells)
    level = float(np.minimum(cells[known], 1.0).mean()) if known.any() else float("nan")
    return cells, level


def dense(points: FloatArray) -> FloatArray:
    """Points (K, 3) without those few that lie in the air: at the borders of what is near, cameras
    see some between near and far.
    """
    if not len(points):
        return points
    cells = np.floor((points - points.min(axis=0)) / AIR).astype(np.int64)
    _, number, count = np.unique(
        cells @ np.array([1 << 40, 1 << 20, 1]), return_inverse=True, return_counts=True
    )
    neighbours = count[number]
    return points[neighbours > 0.3 * np.median(neighbours)]


def _squares(
    xy: FloatArray, box: OrientedBox, fine: list[int]
) -> tuple[NDArray[np.intp], BoolArray]:
    index = np.floor((xy / box.size[:2] + 0.5) * fine).astype(np.intp)
    on = np.all((index >= 0) & (index < fine), axis=1)
    return index[:, 0] * fine[1] + index[:, 1], on


def _mean_heights(inside: FloatArray, box: OrientedBox, fine: list[int]) -> FloatArray:
    key, on = _squares(inside[:, :2], box, fine)
    # Noise brings points of the walls in; the squares along them are as full as their neighbours.
    on &= (np.abs(inside[:, :2]) < box.size[:2] / 2 - WALL_STRIP).all(axis=1)
    z = inside[on, 2] + box.size[2] / 2
    count = np.bincount(key[on], minlength=fine[0] * fine[1])
    total = np.bincount(key[on], z, fine[0] * fine[1])
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(fine)


def _hidden(near: FloatArray, box: OrientedBox, sensor: FloatArray, fine: list[int]) -> BoolArray:
    """Which squares of the floor the sensor cannot see for something in front of them: where
    nothing is in front and yet nothing was seen the floor is dark, and nothing lies on it.
    """
    floor = -box.size[2] / 2
    above = near[:, 2] < sensor[2] - 0.01
    points = near[above]
    reach = (floor - sensor[2]) / (points[:, 2] - sensor[2])
    shadow = sensor[:2] + (points[:, :2] - sensor[:2]) * reach[:, None]
    key, on = _squares(shadow, box, fine)
    hit = np.bincount(key[on], minlength=fine[0] * fine[1]).reshape(fine) > 0
    return np.asarray(ndimage.binary_dilation(hit, iterations=2), bool)


def is_empty(inside: FloatArray, box: OrientedBox, draft: FloatArray, floor_seen: bool) -> bool:
    """Whether nothing lies in the bin, by the rule of `only_support_left`.

    Args:
        inside: (N, 3) points between the walls, in the frame of the box.
        box: the inside.
        draft: (4,) by how much each wall leans outwards (m per m).
        floor_seen: whether the lower face of the box is where the floor was seen.
    """
    lean = np.maximum(draft, 0.0) * box.size[2]
    size = box.size - [2 * max(lean[:2]), 2 * max(lean[2:]), 0.0]
    if (size[:2] <= 2 * WALL_STRIP).any():
        return False
    region = OrientedBox.around(np.zeros(3), size)
    if floor_seen:
        return only_support_left(inside, region, np.array([0.0, 0.0, -1.0]))
    within = (np.abs(inside[:, :2]) < size[:2] / 2 - WALL_STRIP).all(axis=1)
    within &= inside[:, 2] > MIN_HEIGHT - size[2] / 2
    return not within.any() or len(voxel_means(inside[within], VOXEL)) < MIN_VOXELS

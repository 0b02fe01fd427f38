"""From a rim to what is told of the bin: its box, how full it is, how well it was seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud.box import OrientedBox

from .contents import AROUND, dense, depth_of, fill, is_empty
from .found import FoundBin
from .rim import Rim
from .settings import BinSettings

FloatArray = NDArray[np.float64]


def described(
    points: FloatArray,
    rim: Rim,
    sensor: FloatArray | None,
    size: FloatArray | None,
    level_from_cloud: FloatArray,
    noise: float,
    settings: BinSettings,
) -> FoundBin | None:
    """What is known of a bin, in the level frame; None where it is too shallow for one.

    Args:
        points: (3, N) level (m).
        rim: of the bin.
        sensor: (3,) level; None: several places, or not known.
        size: (3,) inner edges and depth if known, 0 for what is not (m).
        level_from_cloud: (3, 3), for the direction of x.
        noise: of the heights (m).
        settings: limits.
    """
    local = rim.local(points).T
    flat = np.abs(local[:, :2])
    between = (flat < rim.half - 0.004).all(axis=1) & (local[:, 2] < 0.25)
    close = (flat < rim.half + AROUND).all(axis=1)
    width = rim.thickness if np.isfinite(rim.thickness) else 0.0
    around = close & (flat > rim.half + 0.01 + width).any(axis=1) & (local[:, 2] < -0.01)
    depth, source = depth_of(local[between], points[:, around].T, rim, noise, settings)
    if size is not None and size[2] > 0:
        depth, source = float(size[2]), "size"
    if not depth >= settings.shallowest:
        return None
    turn = _turn(rim, size, level_from_cloud)
    edges_found = 2 * np.abs(turn[:2, :2] @ rim.half)
    if size is not None and size[:2].any():
        edges_found = size[:2]
    level_from_box = rim.level_from_rim.copy()
    level_from_box[:3, :3] = rim.level_from_rim[:3, :3] @ turn.T
    level_from_box[:3, 3] -= level_from_box[:3, 2] * depth / 2
    box = OrientedBox(level_from_box, np.array([*edges_found, depth]))
    walls, draft = _turned(rim.walls, turn), _turned(rim.draft, turn)
    shift = np.array([0.0, 0.0, depth / 2])
    inside = local[between] @ turn.T + shift
    inside = dense(inside[inside[:, 2] > -depth / 2 - 0.03])
    place = None if sensor is None else box.local(sensor[None])[0]
    cells, level = fill(inside, local[close] @ turn.T + shift, box, place, settings)
    lengths = np.repeat(edges_found[::-1], 2)
    return FoundBin(
        box,
        level,
        cells,
        is_empty(inside, box, draft, source == "floor"),
        walls,
        float(walls @ lengths / lengths.sum()),
        rim.error,
        source,
    )


def _turn(rim: Rim, size: FloatArray | None, level_from_cloud: FloatArray) -> FloatArray:
    """(3, 3) rotation box_from_rim about z: which edge is x, and in which direction it points."""
    first, second = rim.half
    if size is None or not size[:2].any():
        quarter = bool(first < second)
    else:
        off = [np.abs(2 * rim.half - one).max() for one in (size[:2], size[1::-1])]
        quarter = bool(off[1] < off[0])
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) if quarter else np.eye(3)
    x = level_from_cloud.T @ rim.level_from_rim[:3, :3] @ turn[0]
    along = x[0] if abs(x[0]) > 0.1 else x[1] if abs(x[1]) > 0.1 else x[2]
    return turn if along >= 0 else np.diag([-1.0, -1.0, 1.0]) @ turn


def _turned(sides: FloatArray, turn: FloatArray) -> FloatArray:
    """Values (4,) of the walls in the order of the box."""
    values = np.empty(4)
    for side in range(4):
        axis, sign = side // 2, 1 if side % 2 else -1
        there = turn.T @ (np.eye(3)[axis] * sign)
        was = int(np.argmax(np.abs(there)))
        values[side] = sides[2 * was + int(there[was] > 0)]
    return values

"""Which of the outlines is the bin: each is fitted, judged and held against the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .height_map import HeightMap, edges
from .outlines import Outline, outlines
from .picture import Picture
from .rim import Rim, fitted, rim_at
from .settings import BinSettings

FloatArray = NDArray[np.float64]

TRIED = 8
"""Outlines that are looked at closely."""
SURE = 1.55
"""Score of a bin beside which no other is looked at."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    rim: Rim
    score: float


def best_rim(
    points: FloatArray,
    map: HeightMap,
    settings: BinSettings,
    size: FloatArray | None,
    eyes: FloatArray | None,
) -> Rim | None:
    """The rim of the bin of which most is seen; None where no outline is one.

    Args:
        points: (3, N) level (m).
        map: of the points.
        settings: limits.
        size: inner edges (2,) if known (m).
        eyes: (3, N) level, where each point was seen from, or (3, 1); None: not known.
    """
    found: list[_Candidate] = []
    tried: list[Outline] = []
    picture = Picture.of(points, eyes)
    for outline in outlines(edges(map, settings), map.cell, settings, size):
        if len(tried) == TRIED:
            break
        if any(_same(outline, other) for other in tried) or _in_a_plain(outline, map):
            continue
        tried.append(outline)
        rim = fitted(points, rim_at(outline), map.noise, settings, size, eyes)
        if rim is None or not is_bin(rim, map, settings, size, picture):
            continue
        found.append(_Candidate(rim, _score(rim, map)))
        if found[-1].score > SURE:
            break
    if not found:
        return None
    found.sort(key=lambda one: -one.score)
    best = found[0]
    for other in found[1:]:
        # Half a bin, up to something straight in it, looks like a smaller one.
        if other.score < best.score - 0.3:
            break
        if _holds(other.rim, best.rim):
            # Two bins have all walls of either.
            if best.rim.inner.min() < 0.7 and _bridged(other.rim, best.rim):
                best = other
        elif _holds(best.rim, other.rim) and not _bridged(best.rim, other.rim):
            best = other
    return best.rim


def _same(outline: Outline, other: Outline) -> bool:
    turn = abs(outline.yaw - other.yaw)
    return turn < 0.05 and bool(np.abs(outline.sides - other.sides).max() < 0.008)


def _in_a_plain(outline: Outline, map: HeightMap) -> bool:
    """Whether the surroundings of an outline are as high as it on two sides or more: a hole in
    what is seen of a table, or the shadow of something.
    """
    u, v = outline.sides[:2], outline.sides[2:]
    axes = np.array(
        [[np.cos(outline.yaw), np.sin(outline.yaw)], [-np.sin(outline.yaw), np.cos(outline.yaw)]]
    )
    flat = 0
    for side in range(4):
        low, high = v if side < 2 else u
        along = np.linspace(low, high, 24)
        out = outline.sides[side] + (1 if side % 2 else -1) * np.arange(0.006, 0.080, 0.006)
        grid = np.stack(np.meshgrid(out, along, indexing="ij"), axis=-1)
        if side >= 2:
            grid = grid[..., ::-1]
        xy = grid @ axes
        height = map.sample(xy)
        rim = xy @ outline.plane[:2] + outline.plane[2]
        known = np.isfinite(height)
        level = known & (np.abs(height - rim) < 0.012)
        flat += (
            bool(known.any())
            and bool(level.sum() > 0.7 * max(known.sum(), 1))
            and bool(level.mean() > 0.4)
        )
    return flat >= 2


def is_bin(
    rim: Rim,
    map: HeightMap,
    settings: BinSettings,
    size: FloatArray | None,
    picture: Picture | None,
) -> bool:
    """Whether enough of a rim and its walls is seen for a bin, and nothing speaks against it.

    Args:
        rim: in the level frame of the map.
        map: of the points.
        settings: limits.
        size: inner edges (2,) if known (m).
        picture: of the one camera, None where there are several or none is known.
    """
    edges_found = 2 * rim.half
    if edges_found.min() < settings.shortest or edges_found.max() > settings.longest:
        return False
    if rim.level_from_rim[2, 2] < np.cos(settings.max_tilt):
        return False
    if size is not None:
        off = min(np.abs(edges_found - one).max() for one in (size, size[::-1]))
        if off > settings.size_tolerance:
            return False
    lengths = np.repeat(rim.half[::-1], 2)
    worst, third = np.sort(rim.walls)[:2]
    least = settings.side_seen
    if worst < settings.side_seen and size is None:
        least = settings.beside_unseen
    if third < least or rim.walls @ lengths / lengths.sum() < settings.perimeter_seen:
        return False
    # Boxes have outer edges alone.
    inner = np.sort(rim.inner)[1:]
    if inner[0] < 0.1 or inner.mean() < 0.25:
        return False
    if (rim.outside < 0.3).sum() > 1:
        return False
    hollow, flat, beyond = _inside(rim, map)
    if hollow < 0.06 or flat > 0.35:
        return False
    # A wall that is not seen at all may lie outside of the picture.
    return size is not None or all(
        rim.walls[side] >= 0.2
        or (beyond[side] > 0.2 if picture is None else picture.shows(_along(rim, side)))
        for side in range(4)
    )


def _along(rim: Rim, side: int) -> FloatArray:
    """(5, 3) level places along the inside of a wall at the rim."""
    axis, sign = side // 2, 1 if side % 2 else -1
    places = np.zeros((5, 3))
    places[:, axis] = sign * rim.half[axis]
    places[:, 1 - axis] = np.linspace(-1, 1, 5) * rim.half[1 - axis]
    return places @ rim.level_from_rim[:3, :3].T + rim.level_from_rim[:3, 3]


def _inside(rim: Rim, map: HeightMap) -> tuple[float, float, FloatArray]:
    """Share of the inside that is lower than the rim, or not seen; share of what is seen of it
    that is level with the rim, as the top of a box is; and (4,) share of the strip outside each
    wall of which something is seen.
    """
    grid = np.linspace(-0.92, 0.92, 40)
    xy = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2) * rim.half
    height = _over_rim(rim, map, xy)
    seen = np.isfinite(height)
    hollow = float(((height < -0.010) | ~seen).mean())
    flat = float((np.abs(height[seen]) < 0.006).mean()) if seen.any() else 0.0
    beyond = np.zeros(4)
    for side in range(4):
        axis, sign = side // 2, 1 if side % 2 else -1
        along = np.linspace(-1, 1, 30) * rim.half[1 - axis]
        out = rim.half[axis] + np.arange(0.010, 0.070, 0.006)
        places = np.empty((len(along), len(out), 2))
        places[..., axis], places[..., 1 - axis] = sign * out, along[:, None]
        beyond[side] = np.isfinite(_over_rim(rim, map, places.reshape(-1, 2))).mean()
    return hollow, flat, beyond


def _over_rim(rim: Rim, map: HeightMap, xy: FloatArray) -> FloatArray:
    """Height of the map over the rim's plane at places (N, 2) of its frame."""
    level = np.column_stack([xy, np.zeros(len(xy))]) @ rim.level_from_rim[:3, :3].T
    level += rim.level_from_rim[:3, 3]
    return map.sample(level[:, :2]) - level[:, 2]


def _score(rim: Rim, map: HeightMap) -> float:
    lengths = np.repeat(rim.half[::-1], 2)
    share = (rim.walls + 0.5 * rim.inner) @ lengths / lengths.sum()
    centre = map.low + map.cell * np.array(map.top.shape) / 2
    away = np.linalg.norm(rim.level_from_rim[:2, 3] - centre) / (map.cell * max(map.top.shape))
    return float(share + 0.3 * np.sort(rim.walls)[1] - 0.2 * away)


def _holds(large: Rim, small: Rim) -> bool:
    """Whether `small` is a part of `large`."""
    if large.half.prod() < 1.1 * small.half.prod():
        return False
    corners = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]) * [*small.half, 0.0]
    level = corners @ small.level_from_rim[:3, :3].T + small.level_from_rim[:3, 3]
    within = np.abs(large.local(level.T)[:2].T) < large.half + 0.015
    return bool(within.all())


def _bridged(large: Rim, small: Rim) -> bool:
    """Whether the walls of `large` may go on past `small`: no table is seen in their place."""
    turned = abs(float(large.level_from_rim[:3, 0] @ small.level_from_rim[:3, 0])) < 0.7
    part = small.half[::-1] if turned else small.half
    gone = small.open[[2, 3, 0, 1]] if turned else small.open
    missing, length = 0.0, 0.0
    for axis in (0, 1):
        more = 2 * float(large.half[axis] - part[axis])
        if more > 0.03:
            beside = slice(2, 4) if axis == 0 else slice(0, 2)
            whole, some = large.open[beside].sum(), gone[beside].sum()
            missing += 2 * float(large.half[axis] * whole - part[axis] * some)
            length += 2 * more
    return missing <= 0.4 * length

"""From a rectangle on the map to the rim of a bin: its plane and the inside of each wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .outlines import Outline
from .settings import BinSettings
from .walls import INSIDE, OUTSIDE, STEP, Wall, wall_near

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

KNOWN = 0.2
"""A wall seen on a smaller share of its length says nothing of where it is."""
SURE = 0.75
"""A wall seen on a larger share is one, whatever lies beyond it."""
OVERRUN = 0.010
"""How far the rims of its neighbours may go on past the outside of a wall (m)."""
THIN = 0.006
"""Rims thinner than this have hardly a point of their own (m)."""
MORE_ROUNDS = 4
ON_RIM = 0.010
"""Points of the rim's plane are taken so far from the inside of the walls (m)."""


@dataclass(frozen=True, eq=False)
class Rim:
    """The opening of a bin.

    Attributes:
        level_from_rim: (4, 4); origin in the middle of the opening, z out of it, x and y along its
            edges.
        half: (2,) half inner edges (m).
        walls: (4,) share of each wall's length on which its rim or its inside is seen, less that
            on which it is seen that there is none; low x, high x, low y, high y.
        inner: (4,) share on which the step down inside or the inside itself is seen.
        open: (4,) share on which something lower is seen where its rim should be.
        outside: (4,) share on which what lies outside is lower than the rim, or not seen.
        draft: (4,) by how much each wall leans outwards, m per m of height.
        thickness: of the rim (m); NaN where its outer side is nowhere seen.
        error: of the rim's points against their plane, root mean square (m).
    """

    level_from_rim: FloatArray
    half: FloatArray
    walls: FloatArray
    inner: FloatArray
    open: FloatArray
    outside: FloatArray
    draft: FloatArray
    thickness: float
    error: float

    def local(self, points: FloatArray) -> FloatArray:
        """Level points (3, N) in the frame of the rim, (3, N)."""
        rotation, origin = self.level_from_rim[:3, :3], self.level_from_rim[:3, 3]
        return rotation.T @ points - (rotation.T @ origin)[:, None]


def rim_at(outline: Outline) -> Rim:
    """The rim that an outline stands for, nothing of it seen yet."""
    u, v = outline.sides[:2], outline.sides[2:]
    c, s = np.cos(outline.yaw), np.sin(outline.yaw)
    xy = np.array([c, s]) * u.mean() + np.array([-s, c]) * v.mean()
    pose = _pose(
        np.array([*xy, outline.plane @ [*xy, 1.0]]),
        np.array([c, s, outline.plane[:2] @ [c, s]]),
        np.array([-outline.plane[0], -outline.plane[1], 1.0]),
    )
    none, nan = np.zeros(4), float("nan")
    return Rim(pose, np.array([np.ptp(u), np.ptp(v)]) / 2, none, none, none, none, none, nan, nan)


def fitted(
    points: FloatArray,
    rim: Rim,
    noise: float,
    settings: BinSettings,
    size: FloatArray | None,
    eyes: FloatArray | None,
    *,
    slacks: tuple[float, ...] = (0.012, 0.007),
) -> Rim | None:
    """The rim near one that is roughly known; None where there is none after all.

    Args:
        points: (3, N) level.
        rim: where to look.
        noise: of the heights (m).
        settings: limits.
        size: inner edges (2,) if known (m).
        eyes: (3, N) level, where each point was seen from, or (3, 1); None: not known.
        slacks: how far walls may be from where they are expected, one round of fitting each (m).
    """
    band = max(0.005, 2.0 * noise)
    near, views = _near(points, rim, eyes, slacks[0])
    rounds = list(slacks)
    more = MORE_ROUNDS
    while rounds:
        better = _improved(near, rim, band, rounds.pop(0), size, views)
        if better is None or (better.half * 2 < 0.8 * settings.shortest).any():
            return None
        if more and np.abs(better.half - rim.half).max() > 0.4 * INSIDE:
            # A wall that is not seen was not where it was expected: go on to where others end.
            more -= 1
            near, views = _near(points, better, eyes, slacks[0])
            rounds = list(slacks)
        rim = better
    return rim


def _near(
    points: FloatArray, rim: Rim, eyes: FloatArray | None, margin: float
) -> tuple[FloatArray, FloatArray | None]:
    """The points (3, K) near a rim, and where they were seen from."""
    local = rim.local(points)
    flat = np.abs(local[:2])
    keep = (flat < (rim.half + OUTSIDE + margin)[:, None]).all(axis=0)
    keep &= (flat > (rim.half - INSIDE - margin)[:, None]).any(axis=0) & (local[2] < 0.04)
    if eyes is not None and eyes.shape[1] > 1:
        eyes = eyes[:, keep]
    return points[:, keep], eyes


def _pose(origin: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    z = z / np.linalg.norm(z)
    x = x - z * (x @ z)
    x = x / np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    pose[:3, 3] = origin
    return pose


@dataclass(frozen=True, eq=False)
class _Side:
    """What is seen at one of the four walls; low x, high x, low y, high y.

    Attributes:
        wall: where its inside is.
        ends: (2,) see `_ends`.
        corners: (2,) see `_corners`.
        top: (3, K) places on its rim, in the frame of the rim.
    """

    wall: Wall
    ends: FloatArray
    corners: FloatArray
    top: FloatArray


def _improved(
    points: FloatArray,
    rim: Rim,
    band: float,
    slack: float,
    size: FloatArray | None,
    eyes: FloatArray | None,
) -> Rim | None:
    local = rim.local(points)
    views = None if eyes is None else rim.local(eyes)
    sides = [_side(side, local, views, rim, band, slack) for side in range(4)]
    walls = [side.wall for side in sides]
    plane, error = _plane([side.top for side in sides], band)
    if plane is None:
        return None
    seen = np.array([wall.seen for wall in walls])
    known = seen >= KNOWN
    if not (known[:2].any() and known[2:].any()):
        return None
    width = np.array([wall.thickness for wall in walls])
    thickness = float(np.nanmedian(width)) if np.isfinite(width).any() else float("nan")
    edges = _edges(sides, rim, known, thickness, size)
    if edges is None:
        return None
    # Walls that are longer and seen better say more about the direction.
    signs = np.array([1, -1, -1, 1])
    weights = np.array([wall.weight for wall in walls]) * known
    turn = float((signs * [wall.turn for wall in walls]) @ weights / max(weights.sum(), 1e-9))
    gone = np.array([wall.open for wall in walls])
    low, high, lower, upper = edges * [-1, 1, -1, 1]
    middle = np.array([(low + high) / 2, (lower + upper) / 2])
    return Rim(
        _moved(rim.level_from_rim, middle, turn, plane),
        np.array([high - low, upper - lower]) / 2,
        np.maximum(seen - gone, 0.0),
        np.array([wall.inner for wall in walls]),
        gone,
        np.array([wall.outside for wall in walls]),
        np.array([wall.draft for wall in walls]),
        thickness,
        error,
    )


def _side(
    side: int,
    local: FloatArray,
    views: FloatArray | None,
    rim: Rim,
    band: float,
    slack: float,
) -> _Side:
    """What is seen of one wall.

    Args:
        side: 0 to 3.
        local: (3, N) points in the frame of the rim.
        views: (3, N) where each was seen from, in the same frame, or (3, 1); None: not known.
        rim: where to look.
        band: height of what counts as rim, on either side of its plane (m).
        slack: how far the wall may be from where it is expected (m).
    """
    axis, sign = side // 2, 1 if side % 2 else -1
    half = float(rim.half[1 - axis])
    # Across the wall, outwards from where it is expected; along it; and up.
    q, t, z = sign * local[axis] - rim.half[axis], local[1 - axis], local[2]
    on = (q > -INSIDE) & (q < OUTSIDE) & (np.abs(t) < half + INSIDE)
    q, t, z = q[on], t[on], z[on]
    inwards = np.ones(len(q), bool)
    if views is not None:
        view = views[axis, on] if views.shape[1] > 1 else views[axis]
        inwards = sign * view - rim.half[axis] < q
    between = np.abs(t) < half - STEP
    wall = wall_near(
        q[between], t[between], z[between], half, band, slack, rim.thickness, inwards[between]
    )
    width = wall.thickness if np.isfinite(wall.thickness) else 0.006
    line = wall.at + wall.turn * t
    thin = width < THIN
    low, high = (-0.0005, width + 0.0005) if thin else (0.0005, min(width, ON_RIM))
    level = np.abs(z) < band
    top = (q > line + low) & (q < line + high) & level
    ends = _ends(t[top], half)
    corners = _corners(q[level] - line[level], t[level], ends, rim.thickness)
    top &= between
    xyz = np.empty((3, int(top.sum())))
    xyz[axis], xyz[1 - axis], xyz[2] = sign * (rim.half[axis] + q[top]), t[top], z[top]
    return _Side(wall, ends, corners, _pieces(xyz, t[top], half, upper=thin))


def _edges(
    sides: list[_Side], rim: Rim, known: BoolArray, thickness: float, size: FloatArray | None
) -> FloatArray | None:
    """(4,) how far outwards from the middle of the old rim the inside of each wall is (m); None
    where something else than a wall is seen, or one is neither seen nor told by others.

    Args:
        sides: four of them.
        rim: the old one.
        known: (4,) which walls are seen.
        thickness: of the rim (m), NaN where unknown.
        size: inner edges (2,) if known (m).
    """
    ends = np.stack([side.ends for side in sides])
    corners = np.stack([side.corners for side in sides])
    edges = rim.half[[0, 0, 1, 1]] + [side.wall.at for side in sides]
    for side in range(4):
        reach = _reach(side, known, ends)
        if known[side]:
            # Rims that go on past a wall which is hardly seen: it is something in the bin.
            past = reach - edges[side] > OVERRUN + np.nan_to_num(thickness)
            if sides[side].wall.seen < SURE and past.all():
                return None
        elif size is not None:
            edge = min(size, key=lambda one: abs(one - 2 * rim.half[side // 2]))
            edges[side] = edge - edges[side ^ 1]
        elif np.isfinite(reach).any():
            at = _beside(side), side % 2
            edges[side] = _unseen(reach, corners[at], thickness)
        else:
            return None
    return edges


def _moved(
    level_from_rim: FloatArray, middle: FloatArray, turn: float, plane: FloatArray
) -> FloatArray:
    """(4, 4) level_from_rim of a rim whose middle (2,), turn (rad) about z and plane (3,) are seen
    in the frame of an old one.
    """
    rotation, origin = level_from_rim[:3, :3], level_from_rim[:3, 3]
    x = np.array([np.cos(turn), np.sin(turn), 0.0])
    x[2] = plane[:2] @ x[:2]
    return _pose(
        rotation @ [*middle, plane @ [*middle, 1.0]] + origin,
        rotation @ x,
        rotation @ [-plane[0], -plane[1], 1.0],
    )


def _ends(t: FloatArray, half: float) -> FloatArray:
    """(2,) how far from the middle a wall's rim reaches at either end (m); NaN where it does not
    come near it.
    """
    step = 0.003
    bins = int(2 * (half + INSIDE) / step) + 1
    count = np.bincount(((t + half + INSIDE) / step).astype(np.intp), minlength=bins)
    some = count[count > 0]
    found = np.full(2, np.nan)
    if not len(some):
        return found
    full = np.flatnonzero(count >= 0.4 * np.median(some))
    reach = np.array([half + INSIDE - full[0] * step, (full[-1] + 1) * step - half - INSIDE])
    return np.where(reach > half - INSIDE, reach, np.nan)


def _reach(side: int, known: BoolArray, ends: FloatArray) -> FloatArray:
    """(2,) how far from the middle the rims of the neighbours of a wall reach (m); NaN where they
    do not come near it.
    """
    beside = _beside(side)
    return np.array([ends[other, side % 2] if known[other] else np.nan for other in beside])


def _beside(side: int) -> list[int]:
    return [2, 3] if side < 2 else [0, 1]


def _corners(q: FloatArray, t: FloatArray, ends: FloatArray, width: float) -> FloatArray:
    """(2,) how densely level points are seen beside either end of a wall's rim, where the rim of
    its neighbour begins, against the rim itself; NaN where that is not known.
    """
    if not np.isfinite(width):
        return np.full(2, np.nan)
    found = np.full(2, np.nan)
    for end, sign in enumerate((-1, 1)):
        s = ends[end] - sign * t
        own = (q > 0.0) & (q < width) & (s > width) & (s < width + 0.04)
        beside = (q < -0.005) & (q > -0.025) & (s > 0.0) & (s < width)
        if own.sum() > 20:
            found[end] = beside.sum() / 0.020 / (own.sum() / 0.04)
    return found


def _unseen(reach: FloatArray, corners: FloatArray, thickness: float) -> float:
    """Where the inside of a wall that is not seen is, from how far the rims (2,) of its neighbours
    reach (m) and how much of the corners (2,) is seen.

    Rims end with the inside of the wall, or a thickness further out where its corners are seen.
    """
    rims = float(np.nanmax(reach))
    if not np.isfinite(thickness):
        return rims
    return rims - thickness if (corners > 0.4).any() else rims


def _pieces(xyz: FloatArray, t: FloatArray, half: float, *, upper: bool) -> FloatArray:
    """Means (3, K) of a wall's points by pieces of 1 cm, so that near walls do not outvote far
    ones; `upper`: of those above the mean, since others are of the side of a thin rim.
    """
    if not len(t):
        return np.zeros((3, 0))
    piece = ((t + half) / 0.01).astype(np.intp)
    many = np.bincount(piece)
    if upper:
        mean = np.bincount(piece, xyz[2]) / np.maximum(many, 1)
        above = xyz[2] >= mean[piece]
        xyz, piece = xyz[:, above], piece[above]
        many = np.bincount(piece)
    some = many >= 2
    return np.stack([np.bincount(piece, values)[some] / many[some] for values in xyz])


def _plane(parts: list[FloatArray], band: float) -> tuple[FloatArray | None, float]:
    """(3,) plane of the rim in its old frame through places (3, K) of each wall; and the error."""
    if sum(part.shape[1] >= 3 for part in parts) < 2:
        return None, float("nan")
    x, y, z = np.concatenate(parts, axis=1)
    rows = np.column_stack([x, y, np.ones(len(x))])
    plane, near = np.zeros(3), np.ones(len(z), bool)
    for tolerance in (band, 0.7 * band, 0.5 * band):
        near = np.abs(z - rows @ plane) < tolerance
        if near.sum() < 8:
            return None, float("nan")
        plane = np.linalg.lstsq(rows[near], z[near], rcond=None)[0]
    error = z[near] - rows[near] @ plane
    return plane, float(np.sqrt((error**2).mean()))

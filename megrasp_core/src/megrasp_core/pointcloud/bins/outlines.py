"""Rectangles of edges in one plane that fall inwards: what may be the rim of a bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .height_map import DIRECTIONS, Edges
from .settings import BinSettings
from .walls import THICKEST

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

YAWS = 3
"""Directions of walls that are followed up."""
INNER_LINES, OUTER_LINES, UNSEEN_LINES = 7, 5, 6
"""Lines followed up for each wall: of edges that fall inwards; of edges that fall outwards, for a
bin so full that its inside cannot be seen there; where other walls end, for a wall that is not
seen at all."""
THICKNESSES = 2
KEPT = 16
"""Rectangles followed up for each direction."""
CLOSER = 28
"""Rectangles of all directions whose plane is looked for."""
GAP = 0.03
"""A line of edges goes on over gaps as long as this (m)."""
APART = 0.012
"""Least distance of two lines (m)."""
OUTER_WEIGHT = 0.6
"""What an edge that falls outwards counts against one that falls inwards: boxes have them too."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A rectangle on the map, its edges falling inwards.

    Attributes:
        yaw: angle (rad) of its u axis against the map's x.
        sides: (4,) u of the lower and upper, v of the lower and upper side (m).
        plane: (3,) rim plane, z = plane . (x, y, 1).
        seen: (4,) share of each side's length with an edge in that plane.
    """

    yaw: float
    sides: FloatArray
    plane: FloatArray
    seen: FloatArray

    @property
    def score(self) -> float:
        """Share of the outline that was seen, the worst of the best three sides counting more."""
        u, v = float(np.ptp(self.sides[:2])), float(np.ptp(self.sides[2:]))
        shares = self.seen @ [v, v, u, u] / (2 * (u + v))
        return float(shares + 0.3 * np.sort(self.seen)[1])


def outlines(
    edges: Edges, cell: float, settings: BinSettings, size: ArrayLike | None
) -> list[Outline]:
    """Rectangles, best first; of the given inner size (x, y, ...) (m) where one is given."""
    if len(edges.places) < 12:
        return []
    origin = edges.places[:, :2].mean(axis=0)
    rough: list[tuple[float, float, list[_Wall], FloatArray]] = []
    for yaw in _yaws(edges, origin, cell):
        walls = [_Wall(edges, origin, yaw, side, cell, settings) for side in range(4)]
        thicknesses = _thicknesses(walls, cell)
        for wall in walls:
            wall.follow(thicknesses)
        for score, sides in _rectangles(walls, settings, size):
            rough.append((score, yaw, walls, sides))
    rough.sort(key=lambda one: -one[0])
    found: list[Outline] = []
    for _, yaw, walls, sides in rough[:CLOSER]:
        outline = _in_one_plane(walls, sides, yaw, origin, edges, settings)
        if outline is not None:
            found.append(outline)
    found.sort(key=lambda outline: -outline.score)
    return found


class _Wall:
    """Edges that may be those of one wall, for one direction of the walls, and lines through them.

    Across the wall the coordinate q grows along `across`, whatever side the wall is on; `inward`
    is 1 where the inside of the bin is towards greater q, else -1. t runs along the wall.
    """

    def __init__(
        self,
        edges: Edges,
        origin: FloatArray,
        yaw: float,
        side: int,
        cell: float,
        settings: BinSettings,
    ) -> None:
        self.cell, self.inward = cell, 1 if side % 2 == 0 else -1
        across, along = _axis(yaw, side // 2), _axis(yaw, 1 - side // 2)
        towards = _direction(np.arctan2(*(self.inward * across)[::-1]))
        q, t = ((edges.places[:, :2] - origin) @ np.column_stack([across, along])).T
        self.first, self.bins = float(t.min()) - cell, int(np.ptp(t) / cell) + 3
        inner = edges.falls[:, towards]
        outer = edges.falls[:, (towards + DIRECTIONS // 2) % DIRECTIONS]
        self.rows = np.flatnonzero(inner > 0), np.flatnonzero(outer > 0)
        # Edges lie on the border of their cells.
        self.q = (
            q[self.rows[0]] + self.inward * cell / 2,
            q[self.rows[1]] - self.inward * cell / 2,
        )
        self.t = t[self.rows[0]], t[self.rows[1]]
        least = 0.3 * settings.shortest / cell
        self.inner = _peaks(self.q[0], inner[self.rows[0]], cell, INNER_LINES, least)
        self.outer = _peaks(self.q[1], outer[self.rows[1]], cell, OUTER_LINES, 2 * least)
        self.position = np.zeros(0)
        self.thicknesses: list[float] = []

    def follow(self, thicknesses: list[float]) -> None:
        """Take as lines the inner edges and the outer ones less each thickness of the rim."""
        self.thicknesses = thicknesses
        lines = [at for at, _ in self.inner]
        for at, _ in self.outer:
            for thickness in thicknesses:
                line = at + self.inward * thickness
                if all(abs(line - other) > APART / 2 for other in lines):
                    lines.append(line)
        self.position = np.array(lines)
        self._covered = np.zeros((len(lines), self.bins))
        starts, ends = [], []
        for row, line in zip(self._covered, lines):
            inner, outer = self.members(line)
            on, seen = np.zeros(self.bins, bool), np.zeros(self.bins, bool)
            on[self.bin(self.t[0][inner])] = True
            seen[self.bin(self.t[1][outer])] = True
            row[:] = np.where(_closed(on, 2), 1.0, OUTER_WEIGHT * _closed(seen, 2))
            for start, end in _runs(_closed(on, round(GAP / self.cell))):
                if end - start > 0.06 / self.cell:
                    starts.append((end - start, self.first + start * self.cell))
                    ends.append((end - start, self.first + end * self.cell))
        self.starts = _longest(starts, UNSEEN_LINES // 2)
        self.ends = _longest(ends, UNSEEN_LINES // 2)

    def members(self, line: float) -> tuple[BoolArray, BoolArray]:
        """Which inner and which outer edges belong to a wall whose inside is at `line`."""
        inner = np.abs(self.q[0] - line) < 1.6 * self.cell
        behind = (line - self.q[1]) * self.inward
        outer = np.zeros(len(behind), bool)
        for thickness in self.thicknesses:
            outer |= np.abs(behind - thickness) < 1.6 * self.cell
        return inner, outer

    def bin(self, t: ArrayLike) -> NDArray[np.intp]:
        """Number of the cell along the wall."""
        index = np.floor((np.asarray(t) - self.first) / self.cell).astype(np.intp)
        return np.clip(index, 0, self.bins - 1)

    def shares(self, low: FloatArray, high: FloatArray, unseen: int) -> FloatArray:
        """Covered shares (n + unseen, len(low), len(high)) of the lines between places along the
        wall; 0 for the lines at the end, which nobody saw.
        """
        total = np.zeros((len(self.position) + unseen, self.bins + 1))
        total[: len(self.position), 1:] = np.cumsum(self._covered, axis=1)
        # A cell at each end belongs to the corner.
        a, b = self.bin(low) + 1, self.bin(high)
        length = np.maximum(b[None, :] - a[:, None], 1)
        return np.maximum(total[:, b][:, None, :] - total[:, a][:, :, None], 0) / length


def _axis(yaw: float, which: int) -> FloatArray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([c, s]) if which == 0 else np.array([-s, c])


def _direction(angle: float) -> int:
    return round(angle / (2 * np.pi / DIRECTIONS)) % DIRECTIONS


def _yaws(edges: Edges, origin: FloatArray, cell: float) -> list[float]:
    """Angles (rad, 0 to 90 degrees) at which three walls find the longest lines."""
    xy = edges.places[:, :2] - origin
    reach = float(np.abs(xy).max()) * 1.5 + cell
    bins = int(2 * reach / cell) + 2
    groups = [np.flatnonzero(edges.falls[:, k] > 0) for k in range(DIRECTIONS)]
    places = [xy[rows] for rows in groups]
    weights = [edges.falls[rows, k] for k, rows in enumerate(groups)]
    votes = np.zeros(90)
    for degree in range(90):
        longest = []
        for side in range(4):
            angle = np.deg2rad(degree + 90 * side)
            k = _direction(angle)
            q = places[k] @ np.array([np.cos(angle), np.sin(angle)])
            count = np.bincount(((q + reach) / cell).astype(np.intp), weights[k], bins)
            longest.append(float((count[1:] + count[:-1]).max()))
        votes[degree] = sum(sorted(longest)[1:])
    chosen: list[float] = []
    for degree in np.argsort(-votes, kind="stable"):
        turn = [abs((degree - other + 45) % 90 - 45) for other in chosen]
        if not turn or min(turn) > 4:
            chosen.append(float(degree))
        if len(chosen) == YAWS:
            break
    return [float(np.deg2rad(degree)) for degree in chosen]


def _peaks(
    q: FloatArray, weight: NDArray[np.float32], cell: float, lines: int, least: float
) -> list[tuple[float, float]]:
    """Places of the longest lines and how many edges they have."""
    if not len(q):
        return []
    low = float(q.min()) - 2 * cell
    count = np.bincount(((q - low) / cell).astype(np.intp), weight, int(np.ptp(q) / cell) + 5)
    smooth = np.convolve(count, [0.7, 1.0, 0.7], mode="same")
    found: list[tuple[float, float]] = []
    for _ in range(lines):
        best = int(np.argmax(smooth))
        if smooth[best] < least:
            break
        near = slice(max(0, best - 1), best + 2)
        centre = np.average(np.arange(len(count))[near], weights=count[near] + 1e-9)
        found.append((low + (float(centre) + 0.5) * cell, float(smooth[best])))
        reach = round(APART / cell)
        smooth[max(0, best - reach) : best + reach + 1] = 0
    return found


def _thicknesses(walls: list[_Wall], cell: float) -> list[float]:
    """How far outer edges lie behind inner ones, the most frequent first (m)."""
    votes = np.zeros(int(THICKEST / cell) + 2)
    for wall in walls:
        for inner, many in wall.inner:
            for outer, as_many in wall.outer:
                behind = (inner - outer) * wall.inward
                if 0 < behind < THICKEST:
                    votes[round(behind / cell)] += min(many, as_many)
    votes = np.convolve(votes, [0.5, 1.0, 0.5], mode="same")
    found = []
    for _ in range(THICKNESSES):
        best = int(np.argmax(votes))
        if votes[best] <= 0:
            break
        found.append(best * cell)
        votes[max(0, best - 1) : best + 2] = 0
    return found or [2 * cell]


def _closed(on: BoolArray, gap: int) -> BoolArray:
    """A row of cells (T,) with gaps of up to so many cells filled."""
    index = np.flatnonzero(on)
    filled = on.copy()
    step = np.diff(index)
    for at in np.flatnonzero((step > 1) & (step <= gap + 1)):
        filled[index[at] : index[at + 1]] = True
    return filled


def _runs(on: BoolArray) -> list[tuple[int, int]]:
    change = np.flatnonzero(np.diff(np.pad(on.astype(np.int8), 1)))
    return list(zip(change[::2].tolist(), change[1::2].tolist()))


def _longest(ends: list[tuple[int, float]], most: int) -> list[float]:
    found: list[float] = []
    for _, at in sorted(ends, reverse=True):
        if len(found) < most and all(abs(at - other) > APART / 2 for other in found):
            found.append(at)
    return found


def _rectangles(
    walls: list[_Wall], settings: BinSettings, size: ArrayLike | None
) -> list[tuple[float, FloatArray]]:
    """Score and sides (4,) of rectangles of which at least three sides are seen in part."""
    positions = []
    for side, wall in enumerate(walls):
        if size is None:
            others = walls[2:] if side < 2 else walls[:2]
            unseen = [at for other in others for at in (other.starts, other.ends)[side % 2]]
        else:
            step = -wall.inward
            opposite = walls[side ^ 1].position
            unseen = [at + step * edge for at in opposite for edge in np.asarray(size)[:2]]
        positions.append(np.concatenate([wall.position, unseen]))
    a, b, c, d = positions
    if not all(len(each) for each in positions):
        return []
    counts = [len(each) - len(wall.position) for each, wall in zip(positions, walls)]
    u, v = b[None, :] - a[:, None], d[None, :] - c[:, None]
    pairs_u, pairs_v = _pairs(u, v, settings, size)
    i, j = np.nonzero(pairs_u)
    k, m = np.nonzero(pairs_v)
    if not len(i) or not len(k):
        return []
    shares = [
        wall.shares(*((c, d) if side < 2 else (a, b)), counts[side])
        for side, wall in enumerate(walls)
    ]
    across, upward = u[i, j][:, None], v[k, m][None, :]
    seen = np.stack(
        [
            shares[0][i[:, None], k, m],
            shares[1][j[:, None], k, m],
            shares[2][k, i[:, None], j[:, None]],
            shares[3][m, i[:, None], j[:, None]],
        ]
    )
    third = np.partition(seen, 1, axis=0)[1]
    total = (seen[0] + seen[1]) * upward + (seen[2] + seen[3]) * across
    score = total / (2 * (across + upward)) + 0.3 * third
    score[third < 0.4 * settings.side_seen] = -1.0
    if size is not None:
        score[~_fits(across, upward, settings, size)] = -1.0
    order = np.argsort(-score, axis=None, kind="stable")[:400]
    kept: list[tuple[float, FloatArray]] = []
    for row, column in zip(*np.unravel_index(order, score.shape)):
        if score[row, column] < 0.35 or len(kept) == KEPT:
            break
        sides = np.array([a[i[row]], b[j[row]], c[k[column]], d[m[column]]])
        if all(np.abs(sides - other).max() > 0.010 for _, other in kept):
            kept.append((float(score[row, column]), sides))
    return kept


def _pairs(
    u: FloatArray, v: FloatArray, settings: BinSettings, size: ArrayLike | None
) -> tuple[BoolArray, BoolArray]:
    """Which distances of opposite sides may be those of a bin."""
    if size is None:
        return (
            (u >= settings.shortest) & (u <= settings.longest),
            (v >= settings.shortest) & (v <= settings.longest),
        )
    edges = np.asarray(size, np.float64)[:2]
    return tuple(
        np.logical_or.reduce([np.abs(one - edge) < _slack(edge, settings) for edge in edges])
        for one in (u, v)
    )


def _slack(edge: float, settings: BinSettings) -> float:
    """How far an edge may be from the given one: from above a tilted bin is a little shorter."""
    return settings.size_tolerance + 0.015 * edge


def _fits(
    across: FloatArray, upward: FloatArray, settings: BinSettings, size: ArrayLike
) -> BoolArray:
    first, second = np.asarray(size, np.float64)[:2]
    fits = np.zeros(np.broadcast_shapes(across.shape, upward.shape), bool)
    for one, other in ((first, second), (second, first)):
        fits |= (np.abs(across - one) < _slack(one, settings)) & (
            np.abs(upward - other) < _slack(other, settings)
        )
    return fits


def _in_one_plane(
    walls: list[_Wall],
    sides: FloatArray,
    yaw: float,
    origin: FloatArray,
    edges: Edges,
    settings: BinSettings,
) -> Outline | None:
    """The rectangle with the plane in which most of its edges lie; None where too few do."""
    rows, owner, along, outer = [], [], [], []
    for side, wall in enumerate(walls):
        low, high = sides[2:] if side < 2 else sides[:2]
        for kind, members in enumerate(wall.members(float(sides[side]))):
            t = wall.t[kind]
            on = np.flatnonzero(members & (t > low) & (t < high))
            rows.append(wall.rows[kind][on])
            along.append(t[on])
            owner.append(np.full(len(on), side))
            outer.append(np.full(len(on), kind))
    who, where, what = np.concatenate(owner), np.concatenate(along), np.concatenate(outer)
    places = edges.places[np.concatenate(rows)] - [*origin, 0.0]
    if len(places) < 12:
        return None
    band = max(0.006, 0.5 * edges.drop)
    weight = np.where(what == 0, 1.0, OUTER_WEIGHT)
    plane = _plane(places, who, weight, band, settings)
    if plane is None:
        return None
    near = np.abs(places[:, 2] - _homogeneous(places) @ plane) < band
    seen = np.zeros(4)
    for side, wall in enumerate(walls):
        low, high = sides[2:] if side < 2 else sides[:2]
        first, last = int(wall.bin(low)) + 1, int(wall.bin(high))
        if last <= first:
            return None
        rim = []
        for kind in (0, 1):
            on = np.zeros(wall.bins, bool)
            on[wall.bin(where[near & (who == side) & (what == kind)])] = True
            rim.append(_closed(on, 2)[first:last])
        seen[side] = np.where(rim[0], 1.0, OUTER_WEIGHT * rim[1]).mean()
    if np.sort(seen)[1] < 0.5 * settings.side_seen:
        return None
    plane = plane - np.array([0.0, 0.0, plane[:2] @ origin])
    shift = np.repeat([origin @ _axis(yaw, 0), origin @ _axis(yaw, 1)], 2)
    return Outline(yaw, sides + shift, plane, seen)


def _homogeneous(places: FloatArray) -> FloatArray:
    return np.column_stack([places[:, :2], np.ones(len(places))])


def _plane(
    places: FloatArray,
    owner: NDArray[np.intp],
    weight: FloatArray,
    band: float,
    settings: BinSettings,
) -> FloatArray | None:
    """(3,) of the plane, tilted within bounds, that holds most of the weight (M,) of the places
    (M, 3).
    """
    rng = np.random.default_rng(0)
    chosen = places[rng.integers(len(places), size=(128, 3))]
    matrix = chosen.copy()
    matrix[..., 2] = 1.0
    good = np.abs(np.linalg.det(matrix)) > 1e-3
    if not good.any():
        return None
    planes = np.linalg.solve(matrix[good], chosen[good][..., 2:])[..., 0]
    steepest = np.tan(settings.max_tilt)
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) < steepest]
    if not len(planes):
        return None
    scored = rng.permutation(len(places))[:300]
    heights = planes @ _homogeneous(places[scored]).T
    near = np.abs(places[scored, 2] - heights) < band
    # By sides, so that one long wall in clutter does not outvote the others.
    sides = (owner[scored, None] == np.arange(4)) * weight[scored, None]
    by_side = near.astype(np.float64) @ sides
    plane = planes[int(np.argmax(np.sqrt(by_side).sum(axis=1)))]
    everything = _homogeneous(places)
    for _ in range(3):
        near = np.abs(places[:, 2] - everything @ plane) < band
        if near.sum() < 6:
            return None
        plane = np.linalg.lstsq(everything[near], places[near, 2], rcond=None)[0]
    return plane if np.hypot(plane[0], plane[1]) < steepest else None

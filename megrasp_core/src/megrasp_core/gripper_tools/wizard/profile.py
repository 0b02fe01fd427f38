"""The room between two finger groups, cell by cell, seen along the closing axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELL = 0.003
RANGE = 200


@dataclass(frozen=True)
class Profile:
    """Room along the closing axis between two groups in shared cells of the plane across it.

    `room` (N,): from the inner side of the first group to that of the second, negative where they
    overlap. `cells` (N, 2): the cells' places in metres along `across` (2, 3). `middle` (N,):
    middle of the room along the closing axis. `gap`: smallest room, or the distance along the axis
    where no cell is shared. `end`: how far (m) both groups reach along the first basis vector.
    """

    room: NDArray[np.float64]
    middle: NDArray[np.float64]
    cells: NDArray[np.float64]
    across: NDArray[np.float64]
    gap: float
    end: float


def across(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two unit vectors (2, 3) perpendicular to a unit axis (3,) and to each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)]).astype(np.float64)


def pad_profile(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    axis: NDArray[np.float64],
    basis: NDArray[np.float64] | None = None,
    sideways: bool = True,
) -> Profile:
    """Return the room between two groups of surface points.

    Args:
        first: points (N, 3) of the group on the -axis side.
        second: points (M, 3) of the group on the +axis side.
        axis: unit closing axis (3,).
        basis: the plane's unit vectors (2, 3), any by default.
        sideways: whether the faces must be opposite; otherwise the cells are as wide as both.
    """
    basis = across(axis) if basis is None else basis
    end = min(float((points @ basis[0]).max()) for points in (first, second))
    keys, inner = [], []
    for points, sign in ((first, 1.0), (second, -1.0)):
        index = np.floor(points @ basis.T / CELL).astype(np.int64)
        index[:, 1] *= int(sideways)
        key = index[:, 0] * (1 << 20) + index[:, 1]
        depth = sign * (points @ axis)
        order = np.lexsort((-depth, key))
        key, depth = key[order], depth[order]
        unique, where = np.unique(key, return_index=True)
        keys.append(unique)
        inner.append(sign * depth[where])
    shared, one, two = np.intersect1d(keys[0], keys[1], return_indices=True)
    if not len(shared):
        gap = float((second @ axis).min() - (first @ axis).max())
        empty = np.zeros(0)
        return Profile(empty, empty, np.zeros((0, 2)), basis, gap, end)
    room = inner[1][two] - inner[0][one]
    row = np.floor_divide(shared + (1 << 19), 1 << 20)
    column = shared - row * (1 << 20)
    cells = (np.stack([row, column], axis=1) + 0.5) * CELL
    middle = (inner[1][two] + inner[0][one]) / 2.0
    return Profile(room, middle, cells, basis, float(room.min()), end)


def room_ahead(
    moving: NDArray[np.float64], still: NDArray[np.float64], axis: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return how far it is from a part along a direction to what lies ahead of it.

    Args:
        moving: surface points (N, 3) of the part.
        still: surface points (M, 3) of what it may meet.
        axis: unit direction (3,) in which it moves.

    Returns:
        Distances (K,) of the cells across the direction in which both have points, the cells'
        places (K, 3) with no part along it, and the front (K,) of the part along it.
    """
    basis = across(axis)
    keys = []
    for points in (moving, still):
        index = np.floor(points @ basis.T / CELL).astype(np.int64)
        keys.append(index[:, 0] * (1 << 20) + index[:, 1] + (1 << 40))
    cells, where = np.unique(keys[0], return_inverse=True)
    front = np.full(len(cells), -np.inf)
    np.maximum.at(front, where, moving @ axis)
    place = np.minimum(np.searchsorted(cells, keys[1]), len(cells) - 1)
    shared = cells[place] == keys[1]
    ahead = still[shared] @ axis - front[place[shared]]
    room = np.full(len(cells), np.inf)
    np.minimum.at(room, place[shared][ahead > 0.0], ahead[ahead > 0.0])
    kept = np.isfinite(room)
    index = cells[kept] - (1 << 40)
    row = np.floor_divide(index + (1 << 19), 1 << 20)
    column = index - row * (1 << 20)
    places = (np.stack([row, column], axis=1) + 0.5) * CELL @ basis
    return room[kept], places, front[kept]

"""Fewer triangles for meshes that have too many to cast rays at quickly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

# Up to MOST triangles in all are left as they are; more become about AIM.
MOST = 160_000
AIM = 80_000
# Triangles that remain of a smooth surface for each square of the cell's edge.
TRIANGLES_PER_CELL = 3.0
# Longest edge of a cell (m): the thickness of a finger must not vanish in it.
COARSEST = 0.002
# Most cells along one side of a mesh.
FINEST_SHARE = 400
SAMPLE = 20_000


def thinned(meshes: Sequence[Mesh]) -> Sequence[Mesh]:
    """Return the meshes with the vertices of a cell of space merged at their mean, where there
    are more than `MOST` triangles in all; otherwise the meshes themselves.

    A closed surface stays closed. It moves by a fraction of the cell's edge, which is 2 mm at
    most for parts of up to 80 cm; triangles larger than a cell stay as they are.
    """
    if sum(len(faces) for _, faces in meshes) <= MOST:
        return meshes
    area = sum(_area(vertices, faces) for vertices, faces in meshes)
    cell = min(COARSEST, float(np.sqrt(TRIANGLES_PER_CELL * area / AIM)))
    return [_merged(vertices, faces, cell) for vertices, faces in meshes]


def _area(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    """Estimate the area (m2) of a mesh from some of its triangles."""
    step = max(1, len(faces) // SAMPLE)
    corner = vertices[faces[::step]]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return step * float(np.linalg.norm(cross, axis=1).sum()) / 2.0


def _merged(vertices: NDArray[np.float64], faces: NDArray[np.integer], cell: float) -> Mesh:
    """Merge the vertices of each cell (m) and drop the triangles that become lines or points."""
    low, high = vertices.min(axis=0, initial=np.inf), vertices.max(axis=0, initial=-np.inf)
    extent = float((high - low).max())
    if not 0.0 < extent < np.inf:
        return Mesh(vertices, faces)
    scale = 1.0 / max(cell, extent / FINEST_SHARE)
    x, y, z = (
        ((column - start) * scale).astype(np.int32)
        for column, start in zip(vertices.T, low, strict=True)
    )
    key = (x * (y.max() + 1) + y) * (z.max() + 1) + z
    # The first vertex of every cell names it; only the entries that are read are written.
    order = np.arange(len(vertices), dtype=np.int32)
    first = np.empty(key.max() + 1, np.int32)
    first[key[::-1]] = order[::-1]
    named = first[key]
    number = (np.cumsum(named == order, dtype=np.int32) - 1)[named]
    counts = np.bincount(number)
    means = np.stack([np.bincount(number, column) / counts for column in vertices.T], axis=1)
    merged = number[faces]
    a, b, c = merged.T
    return Mesh(means, merged[(a != b) & (b != c) & (c != a)].astype(np.int64))

"""Cutting a closed mesh by planes, with the volume of what is left.

The cut faces are covered by triangles that may overlap and fold, signed so that the whole bounds
the right volume; hulls are those of the surface alone, whose cut edges hold every corner of the
cover that counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.meshes import Mesh

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cut:
    """Triangles (F, 3, 3) of the surface and (K, 3, 3) of what covers the cuts, outward."""

    surface: FloatArray
    cover: FloatArray

    @staticmethod
    def of(mesh: Mesh) -> Cut:
        """A closed mesh that is not cut yet."""
        return Cut(mesh.vertices[mesh.faces], np.zeros((0, 3, 3)))

    def volume(self) -> float:
        """m3."""
        triangles = np.concatenate([self.surface, self.cover])
        if len(triangles) == 0:
            return 0.0
        a, b, c = (triangles[:, k] - triangles[0, 0] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    def vertices(self) -> FloatArray:
        """Corners (N, 3) of the surface."""
        return np.unique(self.surface.reshape(-1, 3), axis=0)


def cut(piece: Cut, normal: FloatArray, offset: float) -> tuple[Cut, Cut]:
    """Return what lies below and above the plane of points x with normal (3,) . x = offset."""
    surface, cover = (
        _clipped(triangles, normal, offset) for triangles in (piece.surface, piece.cover)
    )
    edges = np.concatenate([surface.edges, cover.edges])
    if len(edges) == 0:
        return Cut(surface.below, cover.below), Cut(surface.above, cover.above)
    # Edges run as they bound the lower half: its cover runs against them.
    apex = np.broadcast_to(edges[0, 0], (len(edges), 3))
    lid = np.stack([edges[:, 1], edges[:, 0], apex], axis=1)
    return (
        Cut(surface.below, np.concatenate([cover.below, lid])),
        Cut(surface.above, np.concatenate([cover.above, lid[:, ::-1]])),
    )


def halves_of_vertices(
    piece: Cut, normal: FloatArray, offset: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners (N, 3) of both halves' surfaces: what their hulls need."""
    corners = piece.surface
    height = corners @ normal - offset
    points, rise = corners.reshape(-1, 3), height.reshape(-1)
    crossing = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        across = (height[:, i] < 0.0) != (height[:, j] < 0.0)
        crossing.append(_between(corners[across], height[across], i, j))
    rim = np.concatenate(crossing)
    return (
        np.concatenate([points[rise < 0.0], rim]),
        np.concatenate([points[rise >= 0.0], rim]),
    )


@dataclass(frozen=True, eq=False)
class _Clipped:
    """Triangles below and above a plane, and the edges (E, 2, 3) on it as they bound the lower."""

    below: FloatArray
    above: FloatArray
    edges: FloatArray


def _clipped(triangles: FloatArray, normal: FloatArray, offset: float) -> _Clipped:
    height = triangles @ normal - offset
    under = height < 0.0
    count = under.sum(axis=1)
    below, above, edges = [triangles[count == 3]], [triangles[count == 0]], []
    for alone_is_under, which in ((True, count == 1), (False, count == 2)):
        if not which.any():
            continue
        odd = np.argmax(under[which] == alone_is_under, axis=1)
        order = (odd[:, None] + np.arange(3)) % 3
        corner = np.take_along_axis(triangles[which], order[:, :, None], axis=1)
        rise = np.take_along_axis(height[which], order, axis=1)
        apex, second, third = (corner[:, k] for k in range(3))
        p, q = _between(corner, rise, 0, 1), _between(corner, rise, 0, 2)
        tip = [np.stack([apex, p, q], axis=1)]
        base = [np.stack([p, second, third], axis=1), np.stack([p, third, q], axis=1)]
        if alone_is_under:
            below += tip
            above += base
            edges.append(np.stack([p, q], axis=1))
        else:
            above += tip
            below += base
            edges.append(np.stack([q, p], axis=1))
    none = np.zeros((0, 2, 3))
    return _Clipped(np.concatenate(below), np.concatenate(above), np.concatenate([none, *edges]))


def _between(corner: FloatArray, height: FloatArray, i: int, j: int) -> FloatArray:
    """Where the edges from corner i to corner j cross the plane; the same from either end."""
    a, b, ha, hb = corner[:, i], corner[:, j], height[:, i], height[:, j]
    swap = ha > hb
    a, b = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
    ha, hb = np.where(swap, hb, ha), np.where(swap, ha, hb)
    return a + (ha / (ha - hb))[:, None] * (b - a)

"""Solids that come as a closed surface and as convex pieces which fill it exactly.

Each builder returns a `Solid`: the pieces touch but do not overlap, so volume, centre of mass and
inertia follow from them without error, and what the camera sees is what the fingers touch.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from .model import ConvexPiece, FaceArray, FloatArray

Profile = Sequence[tuple[float, float]]


class Solid(NamedTuple):
    """Closed outer surface and the convex pieces that fill it, in metres, at any origin."""

    vertices: FloatArray
    faces: FaceArray
    pieces: tuple[ConvexPiece, ...]


class MassProperties(NamedTuple):
    """volume (m3), centre (3,) and inertia (3, 3) about the centre at unit density (m5)."""

    volume: float
    centre: FloatArray
    inertia: FloatArray


def convex_piece(points: FloatArray) -> ConvexPiece:
    """Return the convex hull of points (N, 3) with outward faces."""
    hull = ConvexHull(points)
    used = np.unique(hull.simplices)
    number = np.zeros(len(points), np.int32)
    number[used] = np.arange(len(used))
    faces, vertices = number[hull.simplices], points[used]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return ConvexPiece(vertices, faces)


def volume_of(vertices: FloatArray, faces: FaceArray) -> float:
    """Return the signed volume (m3) of a closed mesh with outward faces."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def mass_properties(pieces: Sequence[ConvexPiece]) -> MassProperties:
    """Return volume, centre of mass and inertia of pieces of equal density that do not overlap."""
    volume, moment, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for vertices, faces in pieces:
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        parts = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
        total = a + b + c
        volume += float(parts.sum())
        moment += (parts[:, None] * total).sum(axis=0) / 4
        # Second moments of a tetrahedron with one corner at the origin.
        outer = sum(np.einsum("n,ni,nj->ij", parts, q, q) for q in (a, b, c, total))
        second += np.asarray(outer) / 20
    centre = moment / volume
    second -= volume * np.outer(centre, centre)
    return MassProperties(volume, centre, np.trace(second) * np.eye(3) - second)


def box(size: Sequence[float]) -> Solid:
    """Return a box with these full edges (3,)."""
    x, y, z = (edge / 2 for edge in size)
    return blocks([-x, x], [-y, y], [-z, z], np.ones((1, 1, 1), bool))


def blocks(
    xs: Sequence[float], ys: Sequence[float], zs: Sequence[float], filled: NDArray[np.bool_]
) -> Solid:
    """Return the union of the filled cells of a rectangular grid: brackets, channels, crosses.

    xs, ys, zs: ascending grid lines; filled: (len(xs)-1, len(ys)-1, len(zs)-1). Cells must not
    touch by an edge alone, or the surface is no manifold. Cells in a row along x, then y, then z
    are joined to one piece.
    """
    corner = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1)
    number = np.arange(corner[..., 0].size).reshape(corner.shape[:3])
    padded = np.pad(filled, 1)
    faces: list[tuple[int, int, int]] = []
    for cell in np.argwhere(filled):
        for axis in range(3):
            for side in (0, 1):
                beside = cell + 1
                beside[axis] += 2 * side - 1
                if not padded[tuple(beside)]:
                    faces += _cell_side(number, cell, axis, side)
    used, index = np.unique(np.asarray(faces), return_inverse=True)
    vertices = corner.reshape(-1, 3)[used]
    pieces = tuple(
        convex_piece(corner[np.ix_(*[(low[k], high[k]) for k in range(3)])].reshape(-1, 3))
        for low, high in _joined(filled)
    )
    return Solid(vertices, index.reshape(-1, 3).astype(np.int32), pieces)


def prism(outline: FloatArray, height: float) -> Solid:
    """Return a convex polygon (N, 2), counter-clockwise, extruded from -height/2 to height/2."""
    rings = [
        np.column_stack([outline, np.full(len(outline), z)]) for z in (-height / 2, height / 2)
    ]
    piece = convex_piece(np.concatenate(rings))
    return Solid(piece.vertices, piece.faces, (piece,))


def stack(profile: Profile, sections: int = 32) -> Solid:
    """Return a solid of revolution about z: points (radius, z), z ascending, joined by frusta.

    A step, two points at one height, is allowed. Each run between two heights becomes one convex
    piece.
    """
    points = [(float(r), float(z)) for r, z in profile]
    rim = [(0.0, points[0][1]), *points, (0.0, points[-1][1])]
    vertices, faces = _revolve(rim, sections)
    pieces = tuple(
        convex_piece(np.concatenate([_ring(*low, sections), _ring(*high, sections)]))
        for low, high in itertools.pairwise(points)
        if high[1] - low[1] > 1e-9
    )
    return Solid(vertices, faces, pieces)


def shell(outer: Profile, inner: Profile, sections: int, floor: bool) -> Solid:
    """Return a hollow solid of revolution in wedges: tubes, rings, bowls.

    outer, inner: profile points (radius, z) of the two walls from bottom to top, equally many;
    each quadrangle between them must be convex. floor: the outer profile's first point and the
    inner profile's first bound a solid disc below (a bowl's bottom); then both walls start at
    their own heights and the disc is one piece of its own.
    """
    turns = np.linspace(0, 2 * np.pi, sections + 1)
    wedges: list[ConvexPiece] = []
    for k in range(len(outer) - 1):
        corners = [outer[k], outer[k + 1], inner[k + 1], inner[k]]
        for start, end in itertools.pairwise(turns):
            points = np.array(
                [[r * np.cos(a), r * np.sin(a), z] for a in (start, end) for r, z in corners]
            )
            wedges.append(convex_piece(points))
    if floor:
        base = [_ring(*outer[0], sections), _ring(*inner[0], sections)]
        wedges.append(convex_piece(np.concatenate(base)))
        rim = [(0.0, outer[0][1]), *outer, *reversed(inner), (0.0, inner[0][1])]
        vertices, faces = _revolve(rim, sections)
    else:
        vertices, faces = _revolve([*outer, *reversed(inner), outer[0]], sections)
    return Solid(vertices, faces, tuple(wedges))


def ellipsoid(semi_axes: Sequence[float], subdivisions: int = 2) -> Solid:
    """Return an ellipsoid with these semi-axes (3,)."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    piece = convex_piece(np.asarray(sphere.vertices) * np.asarray(semi_axes))
    return Solid(piece.vertices, piece.faces, (piece,))


def _ring(radius: float, z: float, sections: int) -> FloatArray:
    angle = np.arange(sections) * (2 * np.pi / sections)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sections, z)])


def _revolve(profile: Profile, sections: int) -> tuple[FloatArray, FaceArray]:
    """Return the closed surface of a profile (radius, z) turned about z, faces outward."""
    mesh = trimesh.creation.revolve(np.asarray(profile, dtype=np.float64), sections=sections)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if volume_of(vertices, faces) < 0:
        faces = faces[:, ::-1]
    return vertices, faces.astype(np.int32)


def _cell_side(
    number: NDArray[np.intp], cell: NDArray[np.intp], axis: int, side: int
) -> list[tuple[int, int, int]]:
    """Return the two outward triangles of one side of a grid cell."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    loop = []
    for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
        at = cell.copy()
        at[axis] += side
        at[u] += du
        at[v] += dv
        loop.append(int(number[tuple(at)]))
    if side == 0:
        loop.reverse()
    a, b, c, d = loop
    return [(a, b, c), (a, c, d)]


def _joined(filled: NDArray[np.bool_]) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return (least cell, one past the greatest) of boxes that partition the filled cells."""
    left = filled.copy()
    runs = []
    for cell in np.argwhere(filled):
        if not left[tuple(cell)]:
            continue
        low, high = cell.copy(), cell + 1
        for axis in range(3):
            while high[axis] < filled.shape[axis]:
                further = [slice(int(low[k]), int(high[k])) for k in range(3)]
                further[axis] = slice(int(high[axis]), int(high[axis]) + 1)
                if not left[tuple(further)].all():
                    break
                high[axis] += 1
        left[tuple(slice(int(low[k]), int(high[k])) for k in range(3))] = False
        runs.append((low, high))
    return runs

"""Points drawn on triangle meshes, by area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh, joined


@dataclass(frozen=True)
class SurfaceSample:
    """Surface points (N, 3), unit normals (N, 3), and index (N,) of the mesh each lies on."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    mesh: NDArray[np.int64]

    def part(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> SurfaceSample:
        """The chosen points."""
        return SurfaceSample(self.points[index], self.normals[index], self.mesh[index])


def sample_uniform(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Independent points (count, 3), uniform over the area, and their triangles (count,)."""
    cumulative = np.cumsum(np.linalg.norm(mesh.crosses(), axis=1))
    triangle = np.searchsorted(cumulative, rng.random(count) * cumulative[-1])
    triangle = np.minimum(triangle, len(mesh.faces) - 1)
    u, v = rng.random(count), rng.random(count)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = (mesh.vertices[mesh.faces[triangle, corner]] for corner in range(3))
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), triangle


def sample_stratified(meshes: Sequence[Mesh], count: int, seed: int) -> SurfaceSample:
    """`count` points evenly along the area of all triangles, so that small parts get their share
    every time; normals as the triangles are wound.

    Raises:
        ValueError: no mesh has any area, or a vertex is not finite.
    """
    vertices, faces = joined(meshes)
    x, y, z = np.ascontiguousarray(vertices.T)
    a, b, c = np.ascontiguousarray(faces.T)
    ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    cross = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    area = np.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2)
    total = float(area.sum())
    if not 0.0 < total < np.inf:
        raise ValueError(
            f"there is no surface to draw points on: {len(faces)} triangles of {total / 2.0} m2; "
            "expected finite vertices and at least one mesh with an area"
        )
    rng = np.random.default_rng(seed)
    edges = np.cumsum(area) / total
    ticks = (np.arange(count) + rng.random(count)) / count
    # Rounding may leave a tick behind the last edge: it belongs to the last triangle with an area.
    chosen = np.minimum(np.searchsorted(edges, ticks), np.searchsorted(edges, edges[-1]))
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    corner = vertices[faces[chosen]]
    points = (
        (1.0 - root) * corner[:, 0] + root * (1.0 - v) * corner[:, 1] + root * v * corner[:, 2]
    )
    normals = np.ascontiguousarray((cross[:, chosen] / area[chosen]).T)
    owner = np.searchsorted(np.cumsum([len(f) for _, f in meshes]), chosen, side="right")
    return SurfaceSample(points, normals, owner.astype(np.int64))

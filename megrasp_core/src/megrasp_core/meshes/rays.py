"""Rays against meshes: the one place that knows the ray casting engine, open3d's."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh, joined


class Hits(NamedTuple):
    """First hits of rays of shape (..., 6).

    Attributes:
        distance: (...) float32 in lengths of the ray's direction, infinite without a hit.
        normals: (..., 3) float32 of the triangle as it is wound.
        mesh: (...) uint32, which mesh was hit, where they were kept apart.
    """

    distance: NDArray[np.float32]
    normals: NDArray[np.float32]
    mesh: NDArray[np.uint32]


class RayScene:
    """Meshes that rays are cast at, in one thread and in float32.

    Rays are rows of origin and direction, (..., 6); a direction need not have length 1.
    """

    def __init__(self, meshes: Iterable[Mesh], *, apart: bool = False) -> None:
        """Take meshes; `apart`: hits say which one, otherwise they are joined into one."""
        # Importing open3d takes seconds, and most that imports this module casts no ray.
        import open3d

        self._tensor = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        for vertices, faces in meshes if apart else [joined(meshes)]:
            self._scene.add_triangles(
                self._tensor(np.ascontiguousarray(vertices, np.float32)),
                self._tensor(np.ascontiguousarray(faces, np.uint32)),
            )

    def cast(self, rays: NDArray[np.floating]) -> Hits:
        """The first hit of each ray."""
        hits = self._scene.cast_rays(self._rows(rays), nthreads=1)
        return Hits(
            hits["t_hit"].numpy(), hits["primitive_normals"].numpy(), hits["geometry_ids"].numpy()
        )

    def crossings(
        self, rays: NDArray[np.floating]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """All hits of rays (N, 6): ray (k,), distance (k,), triangle (k,)."""
        hits = self._scene.list_intersections(self._rows(rays), nthreads=1)
        return (
            hits["ray_ids"].numpy().astype(np.int64),
            hits["t_hit"].numpy().astype(np.float64),
            hits["primitive_ids"].numpy().astype(np.int64),
        )

    def blocked(self, rays: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether each ray hits anything."""
        return self._scene.test_occlusions(self._rows(rays), nthreads=1).numpy()

    def distance(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """From points (N, 3) to the nearest triangle: (N,) m."""
        found = self._scene.compute_distance(self._rows(points), nthreads=1)
        return found.numpy().astype(np.float64)

    def nearest(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """The point of the surface nearest to each of points (N, 3): (N, 3)."""
        found = self._scene.compute_closest_points(self._rows(points), nthreads=1)
        return found["points"].numpy().astype(np.float64)

    def _rows(self, array: NDArray[np.floating]):
        return self._tensor(np.ascontiguousarray(array, np.float32))

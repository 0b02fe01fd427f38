"""Distances to meshes and all crossings of rays: the one place that knows open3d's ray scene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import MissingPackageError

from .mesh import Mesh, joined


class SurfaceScene:
    """Meshes, joined into one, in one thread and in float32. First hits alone are quicker to have
    from `RayScene`, which does without open3d.
    """

    def __init__(self, meshes: Iterable[Mesh]) -> None:
        """Take meshes.

        Raises:
            MissingPackageError: open3d is not installed.
        """
        # Importing open3d takes more than a second, and who only synthesizes does not need it.
        try:
            import open3d
        except ImportError as error:
            raise MissingPackageError("open3d", "data", "distances to meshes") from error
        self._tensor = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        vertices, faces = joined(meshes)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(faces, np.uint32)),
        )

    def crossings(
        self, rays: NDArray[np.floating]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """All hits of rays (N, 6), origin and direction: ray (k,), distance (k,) in lengths of the
        direction, triangle (k,).
        """
        hits = self._scene.list_intersections(self._rows(rays), nthreads=1)
        return (
            hits["ray_ids"].numpy().astype(np.int64),
            hits["t_hit"].numpy().astype(np.float64),
            hits["primitive_ids"].numpy().astype(np.int64),
        )

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

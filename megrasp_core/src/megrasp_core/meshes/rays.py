"""First hits of rays on meshes: the one place that knows embreex, the ray casting engine."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh, joined

FARTHEST = 1e36
"""Embree's distance of a ray that hits nothing is more than this."""


class Hits(NamedTuple):
    """First hits of rays of shape (..., 6).

    Attributes:
        distance: (...) float32 in lengths of the ray's direction, infinite without a hit.
        normals: (..., 3) float32 of length 1, of the triangle as it is wound; zero without a hit.
        mesh: (...) uint32, which mesh was hit, where they were kept apart; the largest number
            without a hit.
    """

    distance: NDArray[np.float32]
    normals: NDArray[np.float32]
    mesh: NDArray[np.uint32]


class RayScene:
    """Meshes that rays are cast at, in the thread that calls and in float32.

    Rays are rows of origin and direction, (..., 6); a direction need not have length 1. What goes
    beyond first hits is in `SurfaceScene`.
    """

    def __init__(self, meshes: Iterable[Mesh], *, apart: bool = False) -> None:
        """Take meshes; `apart`: hits say which one, otherwise they are joined into one."""
        # Most that imports this module casts no ray.
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        for vertices, faces in meshes if apart else [joined(meshes)]:
            TriangleMesh(
                self._scene,
                np.ascontiguousarray(vertices, np.float32),
                np.ascontiguousarray(faces, np.int32),
            )

    def cast(self, rays: NDArray[np.floating]) -> Hits:
        """The first hit of each ray."""
        shape = rays.shape[:-1]
        found = self._scene.run(*_split(rays), output=1)
        distance, cross = found["tfar"], found["Ng"]
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        normals = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
        return Hits(
            np.where(distance < FARTHEST, distance, np.float32(np.inf)).reshape(shape),
            normals.reshape(*shape, 3),
            found["geomID"].view(np.uint32).reshape(shape),
        )

    def blocked(self, rays: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether each ray hits anything."""
        found = self._scene.run(*_split(rays), query="OCCLUDED")
        return (found >= 0).reshape(rays.shape[:-1])


def _split(rays: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origins and directions (N, 3)."""
    rows = np.asarray(rays, np.float32).reshape(-1, 6)
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3:])

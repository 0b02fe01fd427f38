"""Which points lie inside the shapes of some links."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from megrasp_core.grippers import body_meshes

INSIDE = 5e-4
"""Points less deep (m) than this touch."""

Planes = tuple[int, NDArray[np.float64], NDArray[np.float64]]


class Solids:
    """The convex shapes of some bodies: collision geometry where there is any, else the visual
    one (meshes as their hulls).

    Args:
        model: compiled model.
        bodies: the bodies' ids.
        seen: take the visual geometry alone.
    """

    def __init__(self, model: mujoco.MjModel, bodies: Collection[int], seen: bool = False) -> None:
        solid = [m for m in body_meshes(model, "collision") if m.body in bodies and not seen]
        owners = {m.body for m in solid}
        shown = [m for m in body_meshes(model, "visual") if m.body in bodies]
        self._planes = [
            (item.body, *_planes(item.mesh.vertices))
            for item in [*solid, *(m for m in shown if m.body not in owners)]
        ]

    @property
    def count(self) -> int:
        """Number of shapes."""
        return len(self._planes)

    def share_inside(self, points: NDArray[np.float64], poses: NDArray[np.float64]) -> float:
        """Return which share of points (N, 3), model frame, lies inside any shape.

        Args:
            points: in the model frame.
            poses: model_from_body (nbody, 4, 4).
        """
        inside = self._inside(points, poses).any(axis=0)
        return float(inside.mean()) if len(points) else 0.0

    def shares_inside(
        self, points: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return which share of points (N, 3) lies inside each shape (count,)."""
        if not len(points):
            return np.zeros(self.count)
        return self._inside(points, poses).mean(axis=1)

    def _inside(
        self, points: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        out = np.zeros((self.count, len(points)), bool)
        for index, (body, normals, offsets) in enumerate(self._planes):
            local = (points - poses[body, :3, 3]) @ poses[body, :3, :3]
            out[index] = ((local @ normals.T - offsets) < -INSIDE).all(axis=1)
        return out


def _planes(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return outward unit normals (F, 3) and offsets (F,) of the hull's faces; none of a flat
    shape, which has no inside.
    """
    try:
        planes = np.unique(np.round(ConvexHull(vertices).equations, 7), axis=0)
    except QhullError:
        return np.zeros((1, 3)), np.zeros(1)
    return planes[:, :3], -planes[:, 3]

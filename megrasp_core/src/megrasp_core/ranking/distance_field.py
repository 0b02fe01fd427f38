"""Distances to a gripper's surface, looked up in a grid that is made once per gripper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from .boxes import inside_bounds, posed_box_bounds

__all__ = ["DistanceField"]

BEST = 64
"""Points that are looked at again between the grid points."""


@dataclass(frozen=True)
class DistanceField:
    """Unsigned distance to a set of surface points, cut off at `limit`.

    Attributes:
        low: (3,) float32, corner of the grid in the gripper frame (m).
        spacing: of the grid (m).
        values: (nx, ny, nz) float32 (m).
        limit: the largest distance; points outside the grid have it.
    """

    low: np.ndarray
    spacing: float
    values: np.ndarray
    limit: float

    @classmethod
    def around(cls, points: np.ndarray, limit: float, spacing: float = 0.004) -> DistanceField:
        """Field of surface points (M, 3).

        Args:
            points: gripper frame (m), denser than the grid.
            limit: largest distance (m).
            spacing: of the grid (m).
        """
        low = points.min(axis=0) - limit
        shape = np.ceil((points.max(axis=0) + limit - low) / spacing).astype(int) + 1
        axes = [low[i] + spacing * np.arange(shape[i]) for i in range(3)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        distance, _ = KDTree(points).query(grid, distance_upper_bound=limit)
        values = np.minimum(distance, limit).astype(np.float32).reshape(tuple(shape))
        return cls(low.astype(np.float32), spacing, values, limit)

    @property
    def high(self) -> np.ndarray:
        """(3,) float32, the corner of the grid opposite to `low` (m)."""
        return self.low + np.float32(self.spacing) * np.array(self.values.shape, np.float32)

    def least(self, points: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Least distance (n,) of points to the surface at each of n poses, `limit` where none of
        them is in the grid (m).

        All points are looked up at their nearest grid point, the best ones again in between.

        Args:
            points: (3, P) float32, in the outer frame (m).
            poses: (n, 4, 4) outer_from_gripper.
        """
        best = [self._best(points, pose) for pose in poses]
        counts = np.array([at.shape[1] for at in best], dtype=np.intp)
        result = np.full(len(best), self.limit, dtype=np.float32)
        some = counts > 0
        if some.any():
            between = self._between(np.concatenate(best, axis=1))
            begins = (np.cumsum(counts) - counts)[some]
            result[some] = np.minimum.reduceat(between, begins)
        return result

    def _best(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Grid coordinates (3, at most `BEST`) of the points (3, P) that may be nearest."""
        near = inside_bounds(points, *posed_box_bounds(pose, self.low, self.high))
        grid_from_outer = (pose[:3, :3].T / self.spacing).astype(np.float32)
        origin = (pose[:3, :3].T @ pose[:3, 3] + self.low) / self.spacing
        at = grid_from_outer @ points[:, near] - origin.astype(np.float32)[:, None]
        nx, ny, nz = self.values.shape
        x, y, z = at
        inside = (x >= 0) & (x < nx - 1) & (y >= 0) & (y < ny - 1) & (z >= 0) & (z < nz - 1)
        at = at[:, inside]
        if at.shape[1] <= BEST:
            return at
        corner = (at + np.float32(0.5)).astype(np.int32)
        rough = self.values.ravel()[(corner[0] * ny + corner[1]) * nz + corner[2]]
        return at[:, np.argpartition(rough, BEST)[:BEST]]

    def _between(self, at: np.ndarray) -> np.ndarray:
        """Trilinear values (P,) at grid coordinates (3, P)."""
        cell = at.astype(np.int32)
        part = at - cell
        total = np.zeros(at.shape[1], dtype=np.float32)
        for corner in range(8):
            step = np.array([(corner >> k) & 1 for k in range(3)])[:, None]
            weight = np.where(step == 1, part, 1.0 - part).prod(axis=0)
            total += weight * self.values[tuple(cell + step)]
        return total

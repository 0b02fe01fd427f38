"""Which places a camera had in its picture, whether anything came back from them or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

FloatArray = NDArray[np.float64]

BORDER = 0.010
"""Places nearer to the border of the picture than this count as outside (m)."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What one camera had in its picture: the convex hull of what came back.

    eye: (3,) where it was. view_from_level: (3, 3) rotation, z along the picture's middle. faces:
    (F, 3) half planes normal . (x, y) + offset <= 0 around what is seen at distance 1.
    """

    eye: FloatArray
    view_from_level: FloatArray
    faces: FloatArray

    @staticmethod
    def of(points: FloatArray, eyes: FloatArray | None) -> Picture | None:
        """None where there are several eyes, or none is known."""
        if eyes is None or eyes.shape[1] != 1:
            return None
        rays = (points - eyes)[:, :: max(1, points.shape[1] // 20_000)]
        rays = rays / np.linalg.norm(rays, axis=0)
        forward = rays.mean(axis=1)
        if np.linalg.norm(forward) < 0.3:
            return None
        z = forward / np.linalg.norm(forward)
        x = np.eye(3)[int(np.argmin(np.abs(z)))]
        x = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
        rotation = np.asarray(np.stack([x, np.cross(z, x), z]), np.float64)
        local = rotation @ rays
        local = local[:, local[2] > 0.1]
        if local.shape[1] < 10:
            return None
        hull = ConvexHull((local[:2] / local[2]).T)
        return Picture(eyes[:, 0], rotation, hull.equations)

    def shows(self, places: FloatArray) -> bool:
        """Whether level places (N, 3) are all in the picture, away from its border."""
        local = self.view_from_level @ (places - self.eye).T
        ahead = local[2] > 1e-3
        xy = local[:2] / np.where(ahead, local[2], 1.0)
        out = (self.faces[:, :2] @ xy + self.faces[:, 2:]).max(axis=0) * local[2]
        return bool((ahead & (out < -BORDER)).all())

"""Is there anything to grasp? Looks for points above the support surface, inside the region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .box import OrientedBox
from .plane import support_plane
from .voxels import voxel_means

FloatArray = NDArray[np.float64]

VOXEL = 0.005
MIN_HEIGHT = 0.010
"""Points this high above the surface (m) are objects: above the noise of depth cameras at arm's
length."""
MIN_VOXELS = 8
"""So many voxels (25 mm2 each, seen from above) make an object; fewer are stray points."""
WALL_STRIP = 0.012
"""Inner strip along the walls of the region (m) where wall and object cannot be told apart."""


def only_support_left(
    points: FloatArray, region: OrientedBox | None, gravity: FloatArray | None
) -> bool:
    """Whether the region shows its support surface and nothing on it.

    False where no support surface is found, since then objects may cover it.

    Args:
        points: (N, 3) finite (m).
        region: in the same frame; None: all points count.
        gravity: (3,) in the same frame; None where unknown.
    """
    if region is not None:
        # Inwards at the sides, but down to below the floor and up to the rim.
        axis = region.face_towards(-gravity)[0] if gravity is not None else 2
        size = region.size - 2 * WALL_STRIP
        size[axis] = region.size[axis] + 2 * WALL_STRIP
        if (size <= 0).any():
            return False
        points = points[OrientedBox(region.world_from_box, size).contains(points)]
    if len(points) < 30:
        return False
    voxels = voxel_means(points, VOXEL)
    plane = support_plane(voxels, gravity)
    if plane is None:
        return False
    return int(np.count_nonzero(plane.height(voxels) > MIN_HEIGHT)) < MIN_VOXELS

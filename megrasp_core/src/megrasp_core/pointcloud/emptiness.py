"""Is there anything to grasp? Looks for points above the support surface, inside the region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import GravityError

from .box import OrientedBox
from .plane import support_plane
from .voxels import VoxelGroups, voxel_means

FloatArray = NDArray[np.float64]

VOXEL = 0.005
MIN_HEIGHT = 0.010
"""Points this high above the surface (m) are objects: above the noise of depth cameras at arm's
length."""
LARGEST_DEPTH = 0.3
"""What hangs deeper (m) under a surface is the ground beside a table."""
MIN_VOXELS = 8
"""So many voxels (25 mm2 each, seen from above) make an object; fewer are stray points."""
WALL_STRIP = 0.012
"""Inner strip along the walls of the region (m) where wall and object cannot be told apart."""


def only_support_left(
    points: FloatArray,
    region: OrientedBox | None,
    gravity: FloatArray | None,
    normals: FloatArray | None = None,
) -> bool:
    """Whether the region shows its support surface and nothing on it.

    False where no support surface is found, since then objects may cover it.

    Args:
        points: (N, 3) finite (m).
        region: in the same frame; None: all points count.
        gravity: (3,) in the same frame; None where unknown.
        normals: (N, 3) unit, towards the sensor; estimated when missing.
    """
    if region is not None:
        # Inwards at the sides, but down to below the floor and up to the rim.
        axis = region.face_towards(-gravity)[0] if gravity is not None else 2
        size = region.size - 2 * WALL_STRIP
        size[axis] = region.size[axis] + 2 * WALL_STRIP
        if (size <= 0).any():
            return False
        inside = OrientedBox(region.world_from_box, size).contains(points)
        points = points[inside]
        normals = None if normals is None else normals[inside]
    if len(points) < 30:
        return False
    groups = VoxelGroups(points, VOXEL)
    voxels = groups.mean(points)
    if normals is not None:
        normals = groups.mean(normals)
        # Sides that look away from each other may cancel; a zero is on no plane.
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    plane = support_plane(voxels, gravity, normals=normals)
    if plane is None:
        return False
    return int(np.count_nonzero(plane.height(voxels) > MIN_HEIGHT)) < MIN_VOXELS


def check_not_upside_down(points: FloatArray, gravity: FloatArray | None) -> None:
    """Refuse an empty support surface under which objects hang.

    Args:
        points: (N, 3) finite (m), of which `only_support_left` says that nothing is on them.
        gravity: (3,) in the same frame; None where unknown.

    Raises:
        GravityError: they hang beside and below it all over.
    """
    if gravity is None:
        return
    voxels = voxel_means(points, VOXEL)
    plane = support_plane(voxels, gravity)
    if plane is None:
        return
    height = plane.height(voxels)
    hang = voxels[(height < -MIN_HEIGHT) & (height > -LARGEST_DEPTH)]
    if len(hang) < max(MIN_VOXELS, 0.01 * len(voxels)):
        return
    on = voxels[np.abs(height) <= MIN_HEIGHT]
    low, high = np.percentile(on, (5, 95), axis=0)
    level = np.ptp(on, axis=0) > 2 * MIN_HEIGHT
    if (((hang > low) & (hang < high)) | ~level).all(axis=1).mean() > 0.5:
        raise GravityError(
            f"nothing lies on the surface that was found, and {len(hang)} voxels hang under it; "
            "expected objects above it. Gravity points the wrong way, or z down: turn the cloud, "
            "or give the vector that points down in its frame "
            f"({' '.join(f'{value + 0.0:.3g}' for value in -gravity)})."
        )

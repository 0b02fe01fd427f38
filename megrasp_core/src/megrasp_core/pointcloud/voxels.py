"""Voxel means: one point for each occupied cell of a grid.

Means and not cell centres: centres jump by a whole cell when the cloud turns a little, and with
them the neighbours that the scene encoder sees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError, InvalidRequestError

FloatArray = NDArray[np.float64]
# Up to this many cells counting into a dense grid beats sorting the keys.
_DENSE_CELLS = 4_000_000


class VoxelGroups:
    """Points grouped by the cells of a grid of edge `size` metres, one centred at the origin.

    Built from finite points (N, 3). `group` (N,) holds the cell of each point, 0..count-1;
    `members` (count,) how many points each cell holds. The order of the cells follows their place
    in the grid, so it is the same for the same cloud. The grid belongs to the frame of the points:
    this is the one step that a rotation of the cloud changes.
    """

    def __init__(self, points: FloatArray, size: float) -> None:
        if not np.isfinite(size) or size <= 0:
            raise InvalidRequestError(
                f"voxel size {size} is not usable; expected metres over 0, e.g. 0.004."
            )
        if len(points) and not np.isfinite(points).all():
            raise CloudError(
                "the points hold NaN or infinity; expected finite coordinates. Drop such rows "
                "with Cloud.finite()."
            )
        # Rounded, not floored: a table at z = 0, where most scenes have it, lies inside a layer of
        # cells and not on the border of two, where noise would give every column of the table two
        # points.
        cells = np.floor(np.ascontiguousarray(points.T) * (1.0 / size) + 0.5)
        self.size = size
        self.group, self.members = _number_cells(cells)

    @property
    def count(self) -> int:
        """Number of occupied cells."""
        return len(self.members)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the mean (count, C) of per-point values (N, C) in each cell."""
        sums = [
            np.bincount(self.group, weights=column, minlength=self.count) for column in values.T
        ]
        return np.stack(sums, axis=1) / self.members[:, None]


def voxel_means(points: FloatArray, size: float) -> FloatArray:
    """Return the mean (M, 3) of the points (N, 3) in each occupied cell of edge `size` metres.

    Raises CloudError for points that are not finite, InvalidRequestError for a size that is not
    positive.
    """
    return VoxelGroups(points, size).mean(points)


def _number_cells(cells: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return for whole-numbered cells (3, N), a row an axis, the dense number of each (N,) and the
    counts.
    """
    if not cells.size:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    low = [row.min() for row in cells]
    nx, ny, nz = (row.max() - least + 1 for row, least in zip(cells, low))
    if nx * ny * nz <= _DENSE_CELLS:
        x, y, z = (row - least for row, least in zip(cells, low))
        key = ((x * ny + y) * nz + z).astype(np.intp)
        counts = np.bincount(key, minlength=int(nx * ny * nz))
        occupied = np.flatnonzero(counts)
        number = np.empty(len(counts), np.intp)
        number[occupied] = np.arange(len(occupied))
        return number[key], counts[occupied]
    # A stray far point makes the grid huge: number axis by axis, so that no key can overflow.
    group = np.unique(cells[0], return_inverse=True)[1].reshape(-1)
    for row in cells[1:]:
        column = np.unique(row, return_inverse=True)[1].reshape(-1)
        group = np.unique(group * (int(column.max()) + 1) + column, return_inverse=True)[
            1
        ].reshape(-1)
    return group, np.bincount(group)

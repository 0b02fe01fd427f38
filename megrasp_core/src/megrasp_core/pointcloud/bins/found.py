"""What is known of a bin that was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud.box import OrientedBox

FloatArray = NDArray[np.float64]

DepthFrom = Literal["floor", "size", "surroundings", "lowest point"]


@dataclass(frozen=True, eq=False)
class FoundBin:
    """A rectangular bin in a cloud, in the cloud's frame; metres.

    Attributes:
        box: the inside, as a region of a request has it: z points out of the opening, the upper
            face is at the rim, the lower one at the floor. Without a given size x runs along the
            longer edge; with one, along the edge given first. Where walls lean outwards the box
            has the size of the opening. Half a turn about z is drawn so that x points along the
            cloud's x axis rather than against it (along y where it is across).
        fill_level: mean height of the contents over the depth, 0 (only the floor) to 1 (level
            with the rim, or over it); NaN where nothing of the inside is seen.
        cells: (rows, columns) the same for each cell, not capped at 1 where the contents stand
            over the rim; NaN where nothing of the cell is seen. Row 0 is at the box's lowest y,
            column 0 at its lowest x, so that cell (r, c) lies around
            x = ((c + 0.5) / columns - 0.5) * box.size[0], y = ((r + 0.5) / rows - 0.5) *
            box.size[1] in the box's frame.
        empty: whether nothing stands out of the floor, by the rule of `only_support_left`; where
            the floor is not seen, whether nothing is seen inside.
        walls_seen: (4,) share of the length on which the rim or the inside of each wall was seen,
            0..1; walls at the box's low x, high x, low y, high y.
        seen: share of the length of all four walls, 0..1.
        rim_error: of the rim's points against the plane of the rim, root mean square.
        depth_from: what the depth was taken from: the floor that is seen; the given size; how high
            the rim stands over what is around the bin (then the floor may be thicker than
            thought); the lowest point seen inside (then the bin may be deeper).
    """

    box: OrientedBox
    fill_level: float
    cells: FloatArray
    empty: bool
    walls_seen: FloatArray
    seen: float
    rim_error: float
    depth_from: DepthFrom

"""What counts as a bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BinSettings:
    """Which rectangles with walls are bins; lengths in metres, angles in radians.

    Attributes:
        shortest, longest: of the inner edges at the rim.
        shallowest: least height of the rim over the floor, or over the lowest that is seen inside.
        max_tilt: largest angle between rim and level, a little over what is promised (10 degrees).
        cell: edge of the grid that rims are looked for in; more where points lie further apart.
        drop: least step down from a rim; more in noisy clouds.
        side_seen: share of a wall's length on which rim or inside must be seen for the wall to
            count as seen; three must.
        beside_unseen: the same where the fourth wall is not seen.
        perimeter_seen: least share of all four walls together.
        size_tolerance: how far inner edges may be from the given ones.
        fill_cell: edge of the cells in which the fill is given, about.
    """

    shortest: float = 0.12
    longest: float = 1.5
    shallowest: float = 0.03
    max_tilt: float = float(np.deg2rad(12.0))
    cell: float = 0.004
    drop: float = 0.012
    side_seen: float = 0.3
    beside_unseen: float = 0.6
    perimeter_seen: float = 0.55
    size_tolerance: float = 0.015
    fill_cell: float = 0.05

"""Why raw samples collide: how deep, and whether with something that the camera saw. A sample
that is a few millimetres deep was denoised too coarsely; one that is a centimetre deep stands
where no grasp is; one that meets what nobody saw could not know.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.simulation import START_DEPTH, World, start_contacts
from megrasp_core.storage import SceneRecord

DEEP = 0.005
VERY_DEEP = 0.010
IN_SIGHT = 0.008
"""A contact this near to a seen point (m) is with something seen; points are 4 mm apart."""


@dataclasses.dataclass
class CollisionCauses:
    """Counts over the samples that collide at the pre-grasp.

    Attributes:
        count: of the samples.
        over_5_mm: those that penetrate by more than 5 mm.
        over_10_mm: by more than 10 mm.
        out_of_sight: all of whose contacts are with something that the camera did not see.
    """

    count: int = 0
    over_5_mm: int = 0
    over_10_mm: int = 0
    out_of_sight: int = 0

    def add(
        self, record: SceneRecord, world: World, world_from_gripper: NDArray[np.float64]
    ) -> None:
        """Count the poses (n, 4, 4) that collide in a record's world."""
        seen = KDTree(record.points.astype(np.float64))
        for depths, places in start_contacts(world, world_from_gripper):
            deep = depths > START_DEPTH
            if not deep.any():
                continue
            self.count += 1
            self.over_5_mm += bool(depths.max() > DEEP)
            self.over_10_mm += bool(depths.max() > VERY_DEEP)
            self.out_of_sight += bool(seen.query(places[deep])[0].min() > IN_SIGHT)

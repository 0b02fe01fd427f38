"""What a camera sees, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class View:
    """One rendered image.

    depth: (h, w) in m along the optical axis, 0 where nothing was hit.
    owner: (h, w) index of the object seen, -1 for table, bin or nothing.
    incidence: (h, w) cosine between ray and surface normal, 1 head-on, 0 grazing.
    """

    depth: NDArray[np.float32]
    owner: NDArray[np.int32]
    incidence: NDArray[np.float32]

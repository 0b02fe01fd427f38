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
    normals: (h, w, 3) of the surface towards the camera, world frame, or None if not known.
    wall: (h, w) index of the bin wall whose inside is seen, -1 elsewhere, or None if not known.
    focal: focal length of the camera in pixels, or None if not known.
    """

    depth: NDArray[np.float32]
    owner: NDArray[np.int32]
    incidence: NDArray[np.float32]
    normals: NDArray[np.float32] | None = None
    wall: NDArray[np.int32] | None = None
    focal: float | None = None

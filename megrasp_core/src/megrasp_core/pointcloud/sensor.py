"""Where the sensor was."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import CloudError


def sensor_place(sensor: ArrayLike, count: int) -> NDArray[np.float64]:
    """The sensor's place (3,), or one for each of `count` points (count, 3), checked.

    Raises:
        CloudError: it has another shape or is not finite.
    """
    place = np.asarray(sensor, dtype=np.float64)
    if place.shape not in ((3,), (count, 3)) or not np.isfinite(place).all():
        raise CloudError(
            f"the sensor's place has the shape {place.shape}; expected three finite numbers (x, "
            f"y, z), or one row for each of the {count} points."
        )
    return place

"""The direction of gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import GravityError


def unit_gravity(gravity: ArrayLike) -> NDArray[np.float64]:
    """Gravity as a unit vector (3,).

    Args:
        gravity: vector (3,) of any length that points down in the frame of the cloud.

    Raises:
        GravityError: it is no direction.
    """
    vector = np.asarray(gravity, dtype=np.float64)
    with np.errstate(over="ignore"):
        length = float(np.linalg.norm(vector)) if vector.shape == (3,) else float("nan")
    if not np.isfinite(length) or length < 1e-6:
        raise GravityError(
            f"gravity {vector.tolist()} is not a direction; expected three numbers that point "
            "down in the frame of the cloud, e.g. 0 0 -1 where z is up."
        )
    return vector / length

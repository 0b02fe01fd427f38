"""What a cell is told: poses and names, checked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError

MAX_REACH = 2.0
"""Poses farther from the bin than this (m) are taken for a mistake of frame or unit."""


def checked_pose(pose: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """The pose as (4, 4) float64; InvalidRequestError if it is no rigid pose near the cell."""
    matrix = np.asarray(pose, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InvalidRequestError(
            f"{what} of shape {matrix.shape} was given; expected a (4, 4) transform of finite "
            "numbers"
        )
    rotation = matrix[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0:
        raise InvalidRequestError(
            f"the rotation of {what} is not orthonormal; expected a right-handed rotation, from "
            "a unit quaternion"
        )
    if np.linalg.norm(matrix[:3, 3]) > MAX_REACH:
        raise InvalidRequestError(
            f"{what} is {np.linalg.norm(matrix[:3, 3]):.2f} m from the bin; expected at most "
            f"{MAX_REACH:g} m: check its frame and that lengths are in metres"
        )
    return matrix


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, with #2, #3 .. behind those that occur again."""
    seen: dict[str, int] = {}
    unique = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        unique.append(name if seen[name] == 1 else f"{name}#{seen[name]}")
    return unique

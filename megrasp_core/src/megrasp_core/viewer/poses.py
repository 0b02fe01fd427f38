"""Poses as viser takes them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix

__all__ = ["Posed", "matrix_of", "move", "position_and_wxyz"]


class Posed(Protocol):
    """A node of the scene: any handle of viser."""

    wxyz: Any
    position: Any


def position_and_wxyz(
    pose: NDArray[np.float64],
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position (3,) and quaternion w, x, y, z of a pose (4, 4)."""
    x, y, z, qx, qy, qz, qw = pose7_from_matrix(pose)
    return (x, y, z), (qw, qx, qy, qz)


def move(node: Posed, parent_from_node: NDArray[np.float64]) -> None:
    """Bring a node to a pose (4, 4) in its parent."""
    node.position, node.wxyz = position_and_wxyz(parent_from_node)


def matrix_of(node: Posed) -> NDArray[np.float64]:
    """Pose (4, 4) of a node in its parent."""
    w, x, y, z = (float(v) for v in node.wxyz)
    return matrix_from_pose7([*(float(v) for v in node.position), x, y, z, w])

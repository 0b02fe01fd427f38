"""How symmetric a gripper is about its approach axis: measured, not assumed."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import Gripper

from .compare import surface_distance

WARNING_RESIDUAL = 0.003


def symmetry_residual(
    gripper: Gripper, order: int | None = None, count: int = 1024, seed: int = 0
) -> float:
    """Return how far the open gripper is from itself after the 1/order turn about +Z through the
    TCP, metres.

    The open cloud is turned and its distance to the surface taken, 95th percentile. `order`
    defaults to the description's `symmetry`; order 1 gives 0.
    """
    order = gripper.description.symmetry if order is None else order
    if order == 1:
        return 0.0
    turn = Rotation.from_euler("z", 2.0 * math.pi / order).as_matrix()
    points = (gripper.clouds(count, seed).open_points - gripper.tcp) @ turn.T + gripper.tcp
    return float(np.percentile(surface_distance(points, gripper.meshes("open")), 95))

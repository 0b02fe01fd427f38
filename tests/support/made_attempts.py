"""Attempts as a cell would record them: a box on a table, grasped from above."""

from __future__ import annotations

from typing import Any

import numpy as np

from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.pointcloud import OrientedBox
from megrasp_core.storage import Attempt

NAME = "robotiq_2f85"


def box_on_a_table(seed: int = 0, count: int = 4000) -> np.ndarray:
    """Points (N, 3) of a table of 40 x 30 cm at z = 0 and the top of a box of 4 x 6 x 5 cm at x =
    5 cm, noise of 0.5 mm.
    """
    rng = np.random.default_rng(seed)
    table = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0), (count, 3))
    under = (np.abs(table[:, 0] - 0.05) < 0.02) & (np.abs(table[:, 1]) < 0.03)
    top = rng.uniform((0.03, -0.03, 0.05), (0.07, 0.03, 0.05), (count // 4, 3))
    points = np.concatenate([table[~under], top])
    points[:, 2] += rng.normal(0.0, 0.0005, len(points))
    return points


def made_attempt(
    time: int = 1,
    *,
    gripper: Gripper | None = None,
    height: float = 0.03,
    tilt: float = 0.0,
    **changes: Any,
) -> Attempt:
    """An attempt at the box with the TCP at this height over the table (m), tilted (rad) about
    the closing axis.
    """
    gripper = gripper or load_gripper(NAME)
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[1:3, 1:3] = [[-np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), -np.cos(tilt)]]
    tcp[:3, 3] = 0.05, 0.0, height
    base = tcp @ np.linalg.inv(gripper.gripper_from_tcp)
    above = base.copy()
    above[2, 3] += 0.1
    values: dict[str, Any] = {
        "time": time,
        "points": box_on_a_table(time),
        "frame": "world",
        "sensor": np.array([0.0, 0.0, 0.8]),
        "gravity": np.array([0.0, 0.0, -1.0]),
        "region": OrientedBox.around((0.0, 0.0, 0.1), (0.4, 0.3, 0.2)),
        "walls": False,
        "gripper": gripper.name,
        "gripper_hash": gripper.hash,
        "world_from_tcp": tcp,
        "world_from_gripper": base,
        "approach": above,
        "retreat": above,
        "opening": 0.08,
        "width": 0.04,
        "score": 0.5,
        "model": "made",
        "seed": time,
        "success": True,
    }
    return Attempt(**(values | changes))

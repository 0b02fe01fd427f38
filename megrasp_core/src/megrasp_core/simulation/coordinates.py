"""Poses (4, 4) to and from a free joint's seven numbers: position, quaternion w first."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray


def write_pose(
    qpos: NDArray[np.float64], address: NDArray[np.int64], pose: NDArray[np.float64]
) -> None:
    """Write a pose into the seven entries of `qpos` at `address` (7,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).ravel())
    qpos[address[:3]] = pose[:3, 3]
    qpos[address[3:]] = quaternion


def read_pose(qpos: NDArray[np.float64], address: NDArray[np.int64]) -> NDArray[np.float64]:
    """Read the pose from the seven entries of `qpos` at `address` (7,)."""
    pose, matrix = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(matrix, qpos[address[3:]])
    pose[:3, :3] = matrix.reshape(3, 3)
    pose[:3, 3] = qpos[address[:3]]
    return pose

"""Poses at file borders, in NumPy: (..., 4, 4) and (..., 7) = [x, y, z, qx, qy, qz, qw]."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError


def pose7_from_matrix(matrix: ArrayLike) -> NDArray[np.float64]:
    """Poses (..., 7) with qw >= 0 of homogeneous matrices (..., 4, 4), float64.

    Raises:
        InvalidRequestError: the last two dimensions are not 4 by 4.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if m.shape[-2:] != (4, 4):
        raise InvalidRequestError(
            f"got poses of shape {m.shape}; expected (..., 4, 4) homogeneous matrices"
        )
    pose = np.empty((*m.shape[:-2], 7))
    pose[..., :3] = m[..., :3, 3]
    if pose.size:
        quat = Rotation.from_matrix(m[..., :3, :3].reshape(-1, 3, 3)).as_quat()
        quat = np.where(quat[:, 3:] < 0, -quat, quat)
        pose[..., 3:] = quat.reshape(*m.shape[:-2], 4)
    return pose


def matrix_from_pose7(pose: ArrayLike) -> NDArray[np.float64]:
    """Homogeneous matrices (..., 4, 4) of poses (..., 7), float64; quaternions of any norm but 0.

    Raises:
        InvalidRequestError: the last dimension is not 7, or a quaternion is zero or not finite.
    """
    p = np.asarray(pose, dtype=np.float64)
    if p.shape[-1:] != (7,):
        raise InvalidRequestError(
            f"got poses of shape {p.shape}; expected (..., 7) as [x, y, z, qx, qy, qz, qw]"
        )
    norm = np.linalg.norm(p[..., 3:], axis=-1)
    if not np.all(np.isfinite(p)) or np.any(norm < 1e-9):
        raise InvalidRequestError(
            "got a pose with a zero quaternion or a number that is not finite; "
            "expected [x, y, z, qx, qy, qz, qw] in metres with a unit quaternion"
        )
    m = np.zeros((*p.shape[:-1], 4, 4))
    m[..., 3, 3] = 1.0
    m[..., :3, 3] = p[..., :3]
    if p.size:
        rotation = Rotation.from_quat(p[..., 3:].reshape(-1, 4)).as_matrix()
        m[..., :3, :3] = rotation.reshape(*p.shape[:-1], 3, 3)
    return m

"""From the model's poses to poses of the gripper in the frame of the cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from megrasp_core.grippers import Gripper

from .request import SynthesisRequest

__all__ = ["PoseSet", "pose_set", "poses_of_tcp"]


@dataclass(frozen=True)
class PoseSet:
    """N grasp poses (N, 4, 4) in the frame of the cloud, float64."""

    tcp: np.ndarray
    gripper: np.ndarray
    approach: np.ndarray

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.tcp)


def pose_set(
    rotation: Tensor,
    translation: Tensor,
    centroid: np.ndarray,
    gripper: Gripper,
    request: SynthesisRequest,
) -> PoseSet:
    """Add the centroid back, in float64, and derive gripper and approach poses.

    Args:
        rotation: (N, 3, 3) scene_from_tcp.
        translation: (N, 3) centred scene coordinates (m).
        centroid: (3,) float64.
        gripper: whose TCP it is.
        request: approach distance and direction, gravity.
    """
    tcp = np.tile(np.eye(4), (len(rotation), 1, 1))
    tcp[:, :3, :3] = _orthonormal(rotation.detach().cpu().double().numpy())
    tcp[:, :3, 3] = translation.detach().cpu().double().numpy() + centroid
    return poses_of_tcp(tcp, gripper, request)


def poses_of_tcp(tcp: np.ndarray, gripper: Gripper, request: SynthesisRequest) -> PoseSet:
    """Derive gripper and approach poses of TCP poses (N, 4, 4)."""
    world_from_gripper = tcp @ np.linalg.inv(
        np.asarray(gripper.gripper_from_tcp, dtype=np.float64)
    )
    approach = world_from_gripper.copy()
    back = -world_from_gripper[:, :3, 2]
    if request.approach_direction == "gravity" and request.gravity is not None:
        back = np.broadcast_to(-request.gravity, back.shape)
    approach[:, :3, 3] += request.approach_distance * back
    return PoseSet(tcp, world_from_gripper, approach)


def _orthonormal(rotation: np.ndarray) -> np.ndarray:
    """Nearest rotations: twenty float32 products leave an error of 1e-6 that float64 users would
    see.
    """
    u, _, vh = np.linalg.svd(rotation)
    u[..., :, -1] *= np.linalg.det(u @ vh)[..., None]
    return u @ vh

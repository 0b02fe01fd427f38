"""From the model's poses to poses of the gripper in the frame of the cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from megrasp_core.grippers import Gripper
from megrasp_core.lie import PoseBatch

from .request import SynthesisRequest

__all__ = ["PoseSet", "pose_set", "scene_from_tcp", "world_from_tcp"]


LIFT = 0.20
"""Height of the retreat over the pre-grasp (m)."""


@dataclass(frozen=True)
class PoseSet:
    """N grasp poses (N, 4, 4) in the frame of the cloud, float64.

    Attributes:
        tcp: TCP frame at the pre-grasp.
        gripper: gripper frame at the pre-grasp.
        approach: gripper frame at the stand-off.
        retreat: gripper frame where to go with the object: up, or where that way is not free (see
            `SceneJudge`), back to the stand-off.
    """

    tcp: np.ndarray
    gripper: np.ndarray
    approach: np.ndarray
    retreat: np.ndarray

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.tcp)

    def moved(self, offset: np.ndarray) -> PoseSet:
        """The same poses, moved by `offset` (3,) (m)."""
        shift = np.zeros((4, 4))
        shift[:3, 3] = offset
        poses = (self.tcp, self.gripper, self.approach, self.retreat)
        return PoseSet(*(pose + shift for pose in poses))


def world_from_tcp(scene_from_tcp: PoseBatch, centroid: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) float64 in the frame of the cloud, whose nodes have this centroid (3,)."""
    tcp = np.tile(np.eye(4), (len(scene_from_tcp), 1, 1))
    tcp[:, :3, :3] = _orthonormal(scene_from_tcp.rotation.detach().cpu().double().numpy())
    tcp[:, :3, 3] = scene_from_tcp.translation.detach().cpu().double().numpy() + centroid
    return tcp


def scene_from_tcp(
    tcp: np.ndarray, centroid: np.ndarray, dtype: torch.dtype, device: torch.device
) -> PoseBatch:
    """Poses (N, 4, 4) of the cloud's frame as the model takes them."""
    return PoseBatch(
        torch.tensor(tcp[:, :3, :3], dtype=dtype, device=device),
        torch.tensor(tcp[:, :3, 3] - centroid, dtype=dtype, device=device),
    )


def pose_set(tcp: np.ndarray, gripper: Gripper, request: SynthesisRequest) -> PoseSet:
    """Gripper and approach poses of TCP poses (N, 4, 4), all in the frame of the cloud."""
    world_from_gripper = tcp @ gripper.tcp_from_gripper
    approach = world_from_gripper.copy()
    back = -world_from_gripper[:, :3, 2]
    if request.approach_direction == "gravity" and request.gravity is not None:
        back = np.broadcast_to(-np.asarray(request.gravity), back.shape)
    approach[:, :3, 3] += request.approach_distance * back
    retreat = approach.copy()
    if request.gravity is not None:
        retreat[:, :3, 3] = world_from_gripper[:, :3, 3] - LIFT * np.asarray(request.gravity)
    return PoseSet(tcp, world_from_gripper, approach, retreat)


def _orthonormal(rotation: np.ndarray) -> np.ndarray:
    """Nearest rotations: twenty float32 products leave an error of 1e-6 that float64 users would
    see.
    """
    u, _, vh = np.linalg.svd(rotation)
    u[..., :, -1] *= np.linalg.det(u @ vh)[..., None]
    return u @ vh

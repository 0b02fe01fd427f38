"""A gripper on its way from open to closed: where its links are and where its fingertips go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper, body_poses
from megrasp_core.grippers.geometry import posed
from megrasp_core.meshes import Mesh, SurfaceScene

__all__ = ["STILL", "ClosingMotion", "closing_motion", "pad_paths"]

STEPS = 64
STILL = 1e-4
"""A link whose pose changes by less (m) does not move."""
LEVEL = 0.35
"""A fingertip's nearest point is at most this share of its distance above or below the TCP."""


@dataclass(frozen=True)
class ClosingMotion:
    """A gripper on its way from open to closed, joints moving in proportion.

    Attributes:
        meshes: of the open gripper, gripper frame.
        closed: of the moving bodies, closed.
        swept: of the moving bodies, at all steps.
        poses: (steps, nbody, 4, 4) gripper_from_body.
        moving: (nbody,) bodies that move.
    """

    meshes: list[Mesh]
    closed: list[Mesh]
    swept: list[Mesh]
    poses: NDArray[np.float64]
    moving: NDArray[np.bool_]


def closing_motion(gripper: Gripper, steps: int = STEPS) -> ClosingMotion:
    """Return the bodies of a gripper at `steps` joint positions from open to closed."""
    start, end = gripper.qpos("open"), gripper.qpos("closed")
    poses = np.stack(
        [body_poses(gripper.model, start + t * (end - start)) for t in np.linspace(0, 1, steps)]
    )
    moving = np.abs(poses[-1] - poses[0]).max(axis=(1, 2)) > STILL
    bodies = gripper.body_meshes("visual")
    movers = [mesh for mesh in bodies if moving[mesh.body]]
    return ClosingMotion(
        meshes=posed(bodies, poses[0]),
        closed=posed(movers, poses[-1]),
        swept=[mesh for at in poses for mesh in posed(movers, at)],
        poses=poses,
        moving=moving,
    )


def pad_paths(gripper: Gripper, motion: ClosingMotion) -> list[NDArray[np.float64]]:
    """Return the paths (steps, 3), gripper frame, of the point of each fingertip that is nearest
    to the TCP when open.

    A fingertip is a last link of a finger group that has a point about level with the TCP; the
    others are knuckles of a linkage.
    """
    model, found = gripper.model, []
    bodies = gripper.body_meshes("visual")
    parents = set(model.body_parentid[[mesh.body for mesh in bodies]].tolist())
    for group in range(len(gripper.description.fingers)):
        tips = []
        for body in np.flatnonzero((gripper.finger_groups == group) & motion.moving):
            own = [mesh for mesh in bodies if mesh.body == body]
            if not own or int(body) in parents:
                continue
            local = np.linalg.inv(motion.poses[0, body]) @ np.append(gripper.tcp, 1.0)
            point = SurfaceScene([one.mesh for one in own]).nearest(local[None, :3])[0]
            path = motion.poses[:, body, :3, :3] @ point + motion.poses[:, body, :3, 3]
            slope = abs(path[0, 2] - gripper.tcp[2]) / max(
                float(np.linalg.norm(point - local[:3])), STILL
            )
            tips.append((slope, path))
        limit = max(LEVEL, min((slope for slope, _ in tips), default=0.0))
        found += [path for slope, path in tips if slope <= limit]
    return found

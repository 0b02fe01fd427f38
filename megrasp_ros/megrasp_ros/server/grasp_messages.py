"""Messages made from the core's grippers and grasps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import Grasp, GraspArray, GripperInfo, RejectionCount, Timing
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from megrasp_ros.conversions import matrix_from_pose, pose_from_matrix

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.synthesizer import PoseSet


@dataclass
class Outcome:
    """The answer to a synthesis request; fields as in SynthesizeGrasps.srv."""

    error_code: int = 0
    error_msg: str = ""
    grasps: GraspArray = field(default_factory=GraspArray)
    timing: Timing = field(default_factory=Timing)
    rejected: list[RejectionCount] = field(default_factory=list)
    notes: tuple[str, ...] = ()

    def fill(self, response: Any) -> Any:
        """Copy into a service response or an action result."""
        response.success = self.error_code == 0
        response.error_code = self.error_code
        response.error_msg = self.error_msg
        response.grasps = self.grasps
        response.timing = self.timing
        response.rejected = self.rejected
        response.notes = list(self.notes)
        return response


def gripper_info(gripper: Gripper, *, seen_in_training: bool) -> GripperInfo:
    """Return the GripperInfo of a loaded gripper."""
    description = gripper.description
    opened, closed = gripper.open_joints, gripper.closed_joints
    return GripperInfo(
        name=gripper.name,
        display_name=description.display_name,
        kind=description.kind,
        description_hash=gripper.hash,
        gripper_from_tcp=pose_from_matrix(gripper.gripper_from_tcp),
        joint_names=list(opened),
        open_positions=[float(v) for v in opened.values()],
        closed_positions=[float(closed[name]) for name in opened],
        max_width=math.nan if description.max_width is None else float(description.max_width),
        min_width=float(description.min_width),
        seen_in_training=seen_in_training,
    )


def grasp_array(
    gripper: Gripper, grasps: Sequence[Any], *, header: Header, model_id: str, seed: int
) -> GraspArray:
    """Return the GraspArray of the core's ranked grasps, in their order."""
    closed = _posture(gripper.closed_joints)
    return GraspArray(
        header=header,
        gripper=gripper.name,
        model_id=model_id,
        seed=seed,
        grasps=[
            Grasp(
                id=rank,
                pregrasp=pose_from_matrix(grasp.world_from_gripper),
                tcp=pose_from_matrix(grasp.world_from_tcp),
                approach=pose_from_matrix(grasp.world_from_gripper_approach),
                pregrasp_posture=_posture(gripper.posture_at(grasp.share)),
                grasp_posture=closed,
                width=_number(grasp.width),
                score=_number(grasp.score),
                clearance=_number(grasp.clearance),
                tilt=_number(grasp.tilt),
                collision_free=bool(grasp.collision_free),
                retreat=pose_from_matrix(grasp.world_from_gripper_retreat),
                width_tolerance=_number(grasp.width_tolerance),
                opening=_number(grasp.opening),
                object=-1 if grasp.object is None else int(grasp.object),
            )
            for rank, grasp in enumerate(grasps)
        ],
    )


def unfinished(
    gripper: Gripper, poses: PoseSet, *, header: Header, model_id: str, seed: int
) -> GraspArray:
    """Return poses of the sampler as grasps: not checked, without width, score and clearance."""
    return GraspArray(
        header=header,
        gripper=gripper.name,
        model_id=model_id,
        seed=seed,
        grasps=[
            Grasp(
                id=index,
                pregrasp=pose_from_matrix(poses.gripper[index]),
                tcp=pose_from_matrix(poses.tcp[index]),
                approach=pose_from_matrix(poses.approach[index]),
                width=math.nan,
                score=0.0,
                clearance=math.nan,
                tilt=math.nan,
                collision_free=False,
                retreat=pose_from_matrix(poses.retreat[index]),
                width_tolerance=math.nan,
                opening=math.nan,
                object=-1,
            )
            for index in range(len(poses))
        ],
    )


def rejection_counts(rejected: dict[str, int]) -> list[RejectionCount]:
    """Return the counts, largest first; reasons that rejected nothing are left out."""
    ordered = sorted(rejected.items(), key=lambda item: -item[1])
    return [RejectionCount(reason=reason, count=int(count)) for reason, count in ordered if count]


def timing_message(
    timing: dict[str, float], *, wait: float, perceive: float, total: float
) -> Timing:
    """Return the Timing of a synthesis; `perceive` (decoding, transform) is added to the core's
    own.
    """
    return Timing(
        wait=wait,
        perceive=perceive + timing.get("perceive", 0.0),
        encode=timing.get("encode", 0.0),
        sample=timing.get("sample", 0.0),
        check=timing.get("rank", 0.0),
        total=total,
    )


def pose_array(
    grasps: GraspArray, which: str, *, gripper_from_reference: NDArray[np.float64] | None = None
) -> PoseArray:
    """Return the poses `pregrasp` or `approach` of all grasps, of the gripper frame or of another
    one.

    gripper_from_reference: (4, 4) pose of the frame to place (TCP, flange) in the gripper frame.
    """
    poses = [getattr(grasp, which) for grasp in grasps.grasps]
    if gripper_from_reference is not None:
        poses = [
            pose_from_matrix(matrix_from_pose(pose, which) @ gripper_from_reference)
            for pose in poses
        ]
    return PoseArray(header=grasps.header, poses=poses)


def _posture(joints: dict[str, float]) -> JointState:
    return JointState(name=list(joints), position=[float(v) for v in joints.values()])


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)

"""The active gripper in tf2: flange to gripper to TCP, so that RViz can place `gripper_cloud`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from megrasp_ros.conversions import pose_from_matrix
from megrasp_ros.qos import LATCHED

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

GRIPPER_FRAME = "gripper"
TCP_FRAME = "gripper_tcp"


def gripper_frames(
    gripper: Gripper, flange_from_gripper: NDArray[np.float64], flange: str, stamp: Time
) -> list[TransformStamped]:
    """Return the transforms flange -> gripper and gripper -> TCP; (4, 4) is the first."""
    return [
        _transform(flange, GRIPPER_FRAME, flange_from_gripper, stamp),
        _transform(GRIPPER_FRAME, TCP_FRAME, gripper.gripper_from_tcp, stamp),
    ]


class StaticFrames:
    """Publishes on `/tf_static`, where tf2_msgs is installed (it does not exist everywhere rclpy
    does).
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._kind: Any = None
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            return
        self._kind = TFMessage
        self._publisher = node.create_publisher(TFMessage, "/tf_static", LATCHED)

    def tell(
        self, gripper: Gripper, flange_from_gripper: NDArray[np.float64], flange: str
    ) -> None:
        """Publish the frames of a gripper; `flange` is the robot's frame, "": nothing."""
        if self._kind is None or not flange:
            return
        stamp = self._node.get_clock().now().to_msg()
        frames = gripper_frames(gripper, flange_from_gripper, flange, stamp)
        self._publisher.publish(self._kind(transforms=frames))


def _transform(
    parent: str, child: str, parent_from_child: NDArray[np.float64], stamp: Time
) -> TransformStamped:
    pose = pose_from_matrix(parent_from_child)
    made = TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child)
    p, q = pose.position, pose.orientation
    made.transform.translation = Vector3(x=p.x, y=p.y, z=p.z)
    made.transform.rotation = Quaternion(x=q.x, y=q.y, z=q.z, w=q.w)
    return made

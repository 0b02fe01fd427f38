"""Everything grasp_server publishes. Pictures (markers, clouds) are made only while somebody
subscribes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import GraspArray, GripperInfo
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from megrasp_core.grippers import Gripper
from megrasp_ros.qos import LATCHED
from megrasp_ros.sensor_messages import cloud_message

from .grasp_messages import pose_array
from .markers import grasp_markers

GRIPPER_FRAME = "gripper"
"""Frame of `gripper_cloud`, to be tied to the robot by its owner."""


class Outputs:
    """The latched topics of grasp_server."""

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node

        def latched(kind: type, name: str):
            return node.create_lifecycle_publisher(kind, name, LATCHED)

        self._pregrasps = latched(PoseArray, "pregrasps")
        self._approach = latched(PoseArray, "approach_poses")
        self._grasps = latched(GraspArray, "grasps")
        self._active = latched(GripperInfo, "active_gripper")
        self._markers = latched(MarkerArray, "grasp_markers")
        self._scene = latched(PointCloud2, "scene_cloud")
        self._gripper = latched(PointCloud2, "gripper_cloud")

    def grasps(
        self,
        grasps: GraspArray,
        gripper: Gripper | None,
        gripper_from_reference: NDArray[np.float64] | None,
    ) -> None:
        """Publish `pregrasps`, `approach_poses`, `grasps` and the markers, in this order."""
        self._pregrasps.publish(
            pose_array(grasps, "pregrasp", gripper_from_reference=gripper_from_reference)
        )
        self._approach.publish(
            pose_array(grasps, "approach", gripper_from_reference=gripper_from_reference)
        )
        self._grasps.publish(grasps)
        if self._markers.get_subscription_count():
            self._markers.publish(grasp_markers(grasps, gripper))

    def nothing(self, frame: str = "") -> None:
        """Publish empty poses and grasps, so that nobody executes the earlier ones."""
        header = Header(stamp=self._node.get_clock().now().to_msg(), frame_id=frame)
        self.grasps(GraspArray(header=header), None, None)

    def active_gripper(self, info: GripperInfo, gripper: Gripper) -> None:
        """Publish the gripper that is active from now on."""
        self._active.publish(info)
        if self._gripper.get_subscription_count():
            stamp = self._node.get_clock().now().to_msg()
            points = gripper.clouds().open_points
            self._gripper.publish(cloud_message(points, frame=GRIPPER_FRAME, stamp=stamp))

    def scene(self, header: Header, points: Callable[[], NDArray[np.float64]]) -> None:
        """Publish the points (N, 3) that a synthesis saw, in the planning frame."""
        if self._scene.get_subscription_count():
            self._scene.publish(cloud_message(points(), frame=header.frame_id, stamp=header.stamp))

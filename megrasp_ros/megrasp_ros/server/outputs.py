"""Everything grasp_server publishes. Pictures (markers, clouds) are made only while somebody
subscribes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import GraspArray, GripperInfo
from numpy.typing import NDArray
from rclpy.lifecycle import LifecyclePublisher
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from megrasp_ros.lifecycle import GuardedLifecycleNode
from megrasp_ros.qos import LATCHED
from megrasp_ros.sensor_messages import cloud_message

from .grasp_messages import pose_array
from .markers import grasp_markers
from .static_frames import GRIPPER_FRAME

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Picture:
    """What markers and scene cloud show: grasps, the gripper they are for, points (N, 3) of the
    scene in the planning frame.
    """

    grasps: GraspArray
    gripper: Gripper
    points: FloatArray


class Outputs:
    """The latched topics of grasp_server.

    `nothing`, `grasps` and `active` are called by ToolState, which sees to their order. Pictures
    are made for whoever subscribes, late ones included: `show` is called now and then.
    """

    def __init__(
        self,
        node: GuardedLifecycleNode,
        info: Callable[[Gripper], GripperInfo],
        tell_frames: Callable[[Gripper], None],
    ) -> None:
        """`info` makes the message of a gripper, `tell_frames` tells tf2 of it."""
        self._node, self._info, self._tell_frames = node, info, tell_frames

        def latched(kind: type, name: str) -> Any:
            return node.create_lifecycle_publisher(kind, name, LATCHED)

        self._pregrasps = latched(PoseArray, "pregrasps")
        self._approach = latched(PoseArray, "approach_poses")
        self._grasps = latched(GraspArray, "grasps")
        self._active = latched(GripperInfo, "active_gripper")
        self._markers = latched(MarkerArray, "grasp_markers")
        self._scene = latched(PointCloud2, "scene_cloud")
        self._gripper = latched(PointCloud2, "gripper_cloud")
        self._lock = threading.Lock()
        self._picture: Picture | None = None
        self._on: Gripper | None = None
        self._shown: set[str] = set()

    def grasps(self, picture: Picture, gripper_from_reference: FloatArray | None) -> None:
        """Publish `pregrasps`, `approach_poses` and `grasps`, in this order, and the pictures."""
        self._poses(picture.grasps, gripper_from_reference)
        with self._lock:
            self._withdraw(picture)
        self.show()

    def nothing(self) -> None:
        """Publish empty poses and grasps, so that nobody executes the earlier ones."""
        self._poses(self._empty(), None)
        with self._lock:
            self._withdraw(None)

    def active(self, gripper: Gripper) -> None:
        """Publish the gripper that is active from now on."""
        self._active.publish(self._info(gripper))
        self._tell_frames(gripper)
        with self._lock:
            self._on = gripper
            self._shown.discard("gripper")

    def show(self) -> None:
        """Publish the pictures that somebody waits for and that have not been made yet."""
        with self._lock:
            picture, on, shown = self._picture, self._on, set(self._shown)
        if on is not None and self._wanted("gripper", self._gripper, shown):
            stamp = self._node.get_clock().now().to_msg()
            cloud = cloud_message(on.clouds().open_points, frame=GRIPPER_FRAME, stamp=stamp)
            self._publish("gripper", self._gripper, cloud, lambda: self._on is on)
        if picture is None:
            return
        header = picture.grasps.header

        def still() -> bool:
            return self._picture is picture

        if self._wanted("markers", self._markers, shown):
            markers = grasp_markers(picture.grasps, picture.gripper)
            self._publish("markers", self._markers, markers, still)
        if self._wanted("scene", self._scene, shown):
            cloud = cloud_message(picture.points, frame=header.frame_id, stamp=header.stamp)
            self._publish("scene", self._scene, cloud, still)

    def _empty(self) -> GraspArray:
        return GraspArray(header=Header(stamp=self._node.get_clock().now().to_msg()))

    def _withdraw(self, picture: Picture | None) -> None:
        """Take back what is shown, also where nobody looks now, for `picture` to follow."""
        self._picture = picture
        if "markers" in self._shown:
            self._markers.publish(grasp_markers(self._empty(), None))
        self._shown -= {"markers", "scene"}

    def _poses(self, grasps: GraspArray, gripper_from_reference: FloatArray | None) -> None:
        for publisher, which in ((self._pregrasps, "pregrasp"), (self._approach, "approach")):
            publisher.publish(
                pose_array(grasps, which, gripper_from_reference=gripper_from_reference)
            )
        self._grasps.publish(grasps)

    @staticmethod
    def _wanted(name: str, publisher: LifecyclePublisher, shown: set[str]) -> bool:
        return name not in shown and publisher.get_subscription_count() > 0

    def _publish(
        self,
        name: str,
        publisher: LifecyclePublisher,
        message: MarkerArray | PointCloud2,
        still: Callable[[], bool],
    ) -> None:
        """Publish a picture, unless what it shows has been replaced while it was made."""
        with self._lock:
            if still():
                publisher.publish(message)
                if publisher.is_activated:
                    self._shown.add(name)

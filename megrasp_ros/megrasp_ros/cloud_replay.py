"""Node that publishes one stored cloud again and again, in place of a camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import InvalidRequestError
from megrasp_core.pointcloud import read_cloud

from .declaring import declare_once
from .process import StopSignals, run_node
from .sensor_messages import cloud_message


class CloudReplay(Node):
    """Publishes `points` from a .ply, .pcd, .npz or .npy file, each time with a new stamp."""

    def __init__(self, name: str = "cloud_replay", **options: Any) -> None:
        """Make the node; `options` are those of rclpy's Node: namespace, context and so on."""
        super().__init__(name, **options)
        path = declare_once(self, "file", "", "cloud file (.ply .pcd .npz .npy), metres")
        self._frame = declare_once(self, "frame_id", "world", "frame of the file's points")
        rate = declare_once(self, "rate", 2.0, "clouds per second (Hz)", low=0.01, high=100.0)
        if not path:
            raise InvalidRequestError(
                "the parameter `file` is empty; expected the path of a .ply, .pcd, .npz or .npy "
                "cloud, for instance --ros-args -p file:=cloud.ply"
            )
        self._message = cloud_message(
            np.asarray(read_cloud(path).points),
            frame=self._frame,
            stamp=self.get_clock().now().to_msg(),
        )
        # Reliable, so that readers of either kind match; depth 1, because only the newest cloud
        # matters.
        self._publisher = self.create_publisher(PointCloud2, "points", 1)
        self.create_timer(1.0 / rate, self._publish)
        self.get_logger().info(
            f"{path}: {self._message.width} points at {rate:g} Hz in frame {self._frame!r}"
        )

    def _publish(self) -> None:
        if self._publisher.get_subscription_count():
            self._message.header.stamp = self.get_clock().now().to_msg()
            self._publisher.publish(self._message)


def main(signals: StopSignals | None = None) -> None:
    """Entry point of the executable `cloud_replay`."""
    run_node(CloudReplay, signals=signals)

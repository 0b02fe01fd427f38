"""Camera of the trials: publishes one stored picture as clouds of 640 x 480 points.

In a process of its own, `python -m megrasp_ros.trials.camera`, as a camera's driver is.
"""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from megrasp_ros.declaring import declare_once
from megrasp_ros.process import StopSignals, run_node
from megrasp_ros.qos import SENSOR

FRAME = "trial_camera_optical_frame"
POINT_STEP = 16
"""Bytes of a point as drivers send it: x, y, z and four for a colour."""

DONE = "published"
"""Begins the line that is printed after the last cloud."""


def picture(seed: int = 5, objects: int = 10) -> NDArray[np.float32]:
    """Points (480, 640, 3) of a simulated bin from above, in the optical frame (m), NaN where the
    camera saw nothing.
    """
    from megrasp_core.objects import procedural_object
    from megrasp_core.simulation import (
        Bin,
        DepthNoise,
        TopDownCamera,
        render_view,
        settle,
    )

    rng = np.random.default_rng(seed)
    models = [procedural_object(int(rng.integers(2**31))) for _ in range(objects)]
    camera = TopDownCamera()
    view = render_view(settle(models, bin=Bin(), rng=rng).world(), camera)
    depth = DepthNoise().apply(view, rng)
    points = camera.rays() * np.where(depth > 0, depth, np.nan)[..., None]
    return points.astype(np.float32)


def region_parameters() -> dict[str, list[float]]:
    """Return `gravity` and the region of grasp_server for `picture`: the inside of the bin."""
    from megrasp_core.lie import pose7_from_matrix
    from megrasp_core.simulation import Bin, TopDownCamera

    region = Bin().region()
    camera_from_world = np.linalg.inv(TopDownCamera().world_from_camera)
    pose = pose7_from_matrix(camera_from_world @ region.world_from_box)
    return {
        "gravity": [0.0, 0.0, 1.0],
        "region.pose": [float(number) for number in pose],
        "region.size": [float(edge) for edge in region.size],
    }


def organised_cloud(points: NDArray[np.float32]) -> PointCloud2:
    """Return a cloud of points (height, width, 3) with the layout of a camera's driver."""
    height, width, _ = points.shape
    data = np.zeros((height, width, POINT_STEP // 4), "<f4")
    data[..., :3] = points
    return PointCloud2(
        header=Header(frame_id=FRAME),
        height=height,
        width=width,
        fields=[
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate("xyz")
        ],
        point_step=POINT_STEP,
        row_step=POINT_STEP * width,
        data=array("B", data.tobytes()),
        is_dense=False,
    )


class TrialCamera(Node):
    """Publishes `points` at a rate, as many as it is told."""

    def __init__(self) -> None:
        super().__init__("trial_camera")
        path = declare_once(self, "file", "", "points (h, w, 3) in the optical frame, .npy")
        rate = declare_once(self, "rate", 15.0, "clouds per second", low=0.1, high=100.0)
        self._left = declare_once(
            self, "count", 0, "clouds after the first subscriber; 0: no end", low=0, high=10**6
        )
        self._endless = self._left == 0
        self._sent = 0
        self._message = organised_cloud(np.load(path))
        self._publisher = self.create_publisher(PointCloud2, "points", SENSOR)
        self.create_timer(1.0 / rate, self._publish)

    def _publish(self) -> None:
        if not self._endless and not (self._left and self._publisher.get_subscription_count()):
            return
        self._message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(self._message)
        self._sent += 1
        self._left -= 1
        if self._left == 0:
            print(f"{DONE} {self._sent}", flush=True)


def main(signals: StopSignals | None = None) -> None:
    """Run the camera."""
    run_node(TrialCamera, threads=1, signals=signals)


if __name__ == "__main__":
    main(StopSignals())

"""Messages of a depth camera, from numpy.

Large arrays go out as `array.array`, which rclpy takes over as it is (bytes cost three times as
much, a numpy array several hundred times).
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header

if TYPE_CHECKING:
    from megrasp_core.simulation import Camera


BYTES_PER_POINT = 12


def cloud_message(points: np.ndarray, *, frame: str, stamp: Time) -> PointCloud2:
    """PointCloud2 with fields x, y, z (float32, m).

    points: (n, 3) gives an unorganised cloud, (height, width, 3) an organised one in which a NaN
    row is a pixel without a reading.
    """
    points = np.asarray(points)
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise ValueError(
            f"points of shape {points.shape} were given; expected (n, 3) or (h, w, 3)"
        )
    height, width = (1, points.shape[0]) if points.ndim == 2 else points.shape[:2]
    data = np.ascontiguousarray(points, dtype="<f4")
    return PointCloud2(
        header=Header(stamp=stamp, frame_id=frame),
        height=int(height),
        width=int(width),
        fields=[
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate("xyz")
        ],
        is_bigendian=False,
        point_step=BYTES_PER_POINT,
        row_step=BYTES_PER_POINT * int(width),
        data=array("B", data.tobytes()),
        is_dense=bool(np.isfinite(data).all()),
    )


def depth_message(depth: np.ndarray, *, frame: str, stamp: Time) -> Image:
    """Image (32FC1) of depths (h, w) in m; pixels without a reading become NaN."""
    data = np.array(depth, dtype="<f4")
    data[~(data > 0)] = np.nan
    return Image(
        header=Header(stamp=stamp, frame_id=frame),
        height=data.shape[0],
        width=data.shape[1],
        encoding="32FC1",
        is_bigendian=0,
        step=4 * data.shape[1],
        data=array("B", data.tobytes()),
    )


def camera_info_message(camera: Camera, *, frame: str, stamp: Time) -> CameraInfo:
    """The camera as a pinhole without distortion."""
    k = camera.intrinsics()
    projection = np.hstack([k, np.zeros((3, 1))])
    return CameraInfo(
        header=Header(stamp=stamp, frame_id=frame),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=k.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )

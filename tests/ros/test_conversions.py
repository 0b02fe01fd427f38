"""Clouds and poses between ROS messages and numpy."""

from __future__ import annotations

from array import array

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from megrasp_msgs.msg import OrientedBox as OrientedBoxMessage
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2, PointField

from megrasp_core.errors import CloudError, InvalidRequestError
from megrasp_ros.conversions import (
    box_from_message,
    matrix_from_numbers,
    matrix_from_pose,
    message_from_box,
    points_from_cloud,
    pose_from_matrix,
)
from megrasp_ros.sensor_messages import cloud_message

POINTS = np.array([[0.1, -0.2, 0.3], [1.0, 2.0, 3.0], [-4.5, 0.0, 0.25], [7.0, 8.0, 9.0]])


def cloud(
    points: np.ndarray,
    *,
    height: int = 1,
    kind: str = "<f4",
    order: str = "xyz",
    before: int = 0,
    after: int = 0,
    row_padding: int = 0,
) -> PointCloud2:
    """Return a cloud with padding before and after the coordinates, and after each row; junk in
    the padding.
    """
    dtype = np.dtype(kind)
    step = before + 3 * dtype.itemsize + after
    width = len(points) // height
    rows = []
    for row in points.reshape(height, width, 3):
        for point in row:
            values = np.array([point["xyz".index(axis)] for axis in order], dtype)
            rows.append(b"\xab" * before + values.tobytes() + b"\xcd" * after)
        rows.append(b"\xef" * row_padding)
    datatype = PointField.FLOAT32 if dtype.itemsize == 4 else PointField.FLOAT64
    fields = (
        [PointField(name="rgb", offset=0, datatype=PointField.UINT8, count=1)] if before else []
    )
    fields += [
        PointField(name=axis, offset=before + i * dtype.itemsize, datatype=datatype, count=1)
        for i, axis in enumerate(order)
    ]
    return PointCloud2(
        height=height,
        width=width,
        fields=fields,
        is_bigendian=kind.startswith(">"),
        point_step=step,
        row_step=step * width + row_padding,
        data=array("B", b"".join(rows)),
    )


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("height", [1, 2])
@pytest.mark.parametrize(("before", "after", "row_padding"), [(0, 0, 0), (3, 5, 0), (16, 4, 11)])
def test_every_layout_gives_the_same_points(
    kind: str, height: int, before: int, after: int, row_padding: int
) -> None:
    message = cloud(
        POINTS, height=height, kind=kind, before=before, after=after, row_padding=row_padding
    )
    np.testing.assert_allclose(points_from_cloud(message), POINTS, atol=1e-6)


def test_fields_may_stand_in_any_order() -> None:
    np.testing.assert_allclose(points_from_cloud(cloud(POINTS, order="zxy")), POINTS, atol=1e-6)


def test_integer_fields_are_numbers_too() -> None:
    message = cloud(np.round(POINTS))
    message.data = array("B", np.round(POINTS).astype("<i4").tobytes())
    for field in message.fields:
        field.datatype = PointField.INT32
    np.testing.assert_allclose(points_from_cloud(message), np.round(POINTS))


def test_rows_with_nan_or_infinity_are_left_out() -> None:
    points = POINTS.copy()
    points[1, 2], points[2, 0] = np.nan, np.inf
    np.testing.assert_allclose(
        points_from_cloud(cloud(points, height=2)), POINTS[[0, 3]], atol=1e-6
    )


def test_a_single_row_may_lack_its_row_step() -> None:
    message = cloud(POINTS)
    message.row_step = 0
    np.testing.assert_allclose(points_from_cloud(message), POINTS, atol=1e-6)


def test_own_clouds_come_back() -> None:
    message = cloud_message(POINTS, frame="world", stamp=PointCloud2().header.stamp)
    np.testing.assert_allclose(points_from_cloud(message), POINTS, atol=1e-6)


def without_z() -> PointCloud2:
    message = cloud(POINTS)
    message.fields = message.fields[:2]
    return message


def changed(**values: object) -> PointCloud2:
    message = cloud(POINTS, height=2)
    for name, value in values.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (PointCloud2(), ["empty", "at least one point", "camera"]),
        (cloud(np.full((4, 3), np.nan)), ["none of the 4 points", "infinite", "metres"]),
        (without_z(), ["fields x, y and lacks z", "Remap"]),
        (changed(fields=[]), ["none", "x, y, z"]),
        (changed(data=array("B", b"abc")), ["3 bytes", "expected 48", "cut"]),
        (changed(row_step=5), ["row_step is 5", "at least 24"]),
        (changed(point_step=4), ["ends at byte", "4 bytes"]),
        (changed(height=2**31), ["holds 48 bytes"]),
    ],
)
def test_a_bad_cloud_says_what_is_wrong(message: PointCloud2, words: list[str]) -> None:
    with pytest.raises(CloudError) as caught:
        points_from_cloud(message)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_an_unknown_datatype_is_named() -> None:
    message = cloud(POINTS)
    message.fields[1].datatype = 99
    with pytest.raises(CloudError, match="field y has the unknown datatype 99"):
        points_from_cloud(message)


def test_poses_come_back() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    matrix[:3, 3] = 1.0, -2.0, 0.5
    np.testing.assert_allclose(
        matrix_from_pose(pose_from_matrix(matrix), "pose"), matrix, atol=1e-12
    )


def test_a_quarter_turn_about_z_is_x_y_z_w() -> None:
    pose = Pose(
        position=Point(x=1.0), orientation=Quaternion(x=0.0, y=0.0, z=0.5**0.5, w=0.5**0.5)
    )
    matrix = matrix_from_pose(pose, "pose")
    np.testing.assert_allclose(matrix @ [1, 0, 0, 1], [1, 1, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    "numbers", [[0.0] * 7, [0, 0, 0, 0, 0, 0, 1.5], [np.nan, 0, 0, 0, 0, 0, 1], [0, 0, 0, 1]]
)
def test_a_bad_pose_is_named(numbers: list[float]) -> None:
    with pytest.raises(InvalidRequestError, match=r"extrinsics is .*expected finite x, y, z"):
        matrix_from_numbers(numbers, "extrinsics")


def test_boxes_come_back_and_size_zero_is_unset() -> None:
    message = OrientedBoxMessage(
        pose=Pose(position=Point(z=0.075)), size=Vector3(x=0.4, y=0.3, z=0.15)
    )
    box = box_from_message(message)
    assert box is not None
    np.testing.assert_allclose(box.size, [0.4, 0.3, 0.15])
    assert message_from_box(box) == message
    assert box_from_message(OrientedBoxMessage()) is None


def test_a_box_with_a_negative_edge_is_refused() -> None:
    with pytest.raises(InvalidRequestError, match="over 0"):
        box_from_message(OrientedBoxMessage(size=Vector3(x=0.4, y=-0.3, z=0.15)))

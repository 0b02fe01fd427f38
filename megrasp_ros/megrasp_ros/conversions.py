"""Poses, boxes and clouds between ROS messages and numpy. All matrices are (4, 4) homogeneous,
metres.

PointCloud2 is decoded here with a structured dtype made from the message's own fields, so that it
works for every field order, padding, byte order and organised or unorganised layout, and needs no
further ROS package.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from megrasp_msgs.msg import OrientedBox as OrientedBoxMessage
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField

from megrasp_core.errors import CloudError, InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud, OrientedBox

FloatArray = NDArray[np.float64]

_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
_WHOLE = tuple(number for number, name in _TYPES.items() if not name.startswith("f"))

LABEL = "label"
"""The field of a cloud that tells objects apart, as PCL names it."""

FARTHEST = 1e6
"""A coordinate beyond this (m) is no reading but a fault of the sensor; a pose is no pose."""


def points_from_cloud(message: PointCloud2) -> FloatArray:
    """Return the points (N, 3) of `cloud_from_message`. Raises CloudError."""
    return cloud_from_message(message).points


def cloud_from_message(message: PointCloud2) -> Cloud:
    """Return the finite points of a cloud, in its own frame (m), in the order of the message;
    those that are exactly 0 0 0 or beyond `FARTHEST` are no readings and left out.

    A field `label` of whole numbers becomes the labels of the points: which object one belongs to.

    Raises CloudError when the cloud is empty, has no numeric fields x, y and z, its data is
    shorter than its layout says, or no point is a reading.
    """
    count = message.width * message.height
    from megrasp_core.pointcloud import Cloud, without_zeros

    if count == 0:
        raise CloudError(
            f"the cloud is empty (width {message.width}, height {message.height}); expected at "
            "least one point. Check the camera and its topic."
        )
    # The data first: numbers that fit it are no larger than memory.
    data = _checked_data(message)
    kind = _point_dtype(message)
    records = np.ndarray(
        (message.height, message.width),
        dtype=kind,
        buffer=data,
        strides=(message.row_step if message.height > 1 else 0, message.point_step),
    )
    points = np.stack([records[axis].astype(np.float64) for axis in "xyz"], axis=-1).reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        points[(np.abs(points) > FARTHEST).any(axis=1)] = np.nan
    labels = whole_labels(records[LABEL]).ravel() if LABEL in (kind.names or ()) else None
    seen = without_zeros(Cloud(points, labels=labels).finite())
    if not len(seen):
        raise CloudError(
            f"none of the {count} points of the cloud is a reading: all are NaN, infinite or 0 0 "
            "0; expected metres. Check that the camera sees the scene within its range."
        )
    return seen


def whole_labels(labels: NDArray) -> NDArray[np.int32]:
    """Return the numbers of objects; those that are none (0, negative, or the highest of 32 bits,
    as some take for none) become 0.
    """
    wide = labels.astype(np.int64)
    return np.where((wide > 0) & (wide <= np.iinfo(np.int32).max), wide, 0).astype(np.int32)


def _point_dtype(message: PointCloud2) -> np.dtype:
    fields = {field.name: field for field in message.fields}
    names = [field.name for field in message.fields]
    twice = [axis for axis in "xyz" if names.count(axis) > 1]
    if twice:
        raise CloudError(
            f"the cloud has several fields {', '.join(twice)}; expected one of each. The "
            "publisher fills the message wrongly."
        )
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise CloudError(
            f"the cloud has the fields {_named(names)} and lacks {', '.join(missing)}; "
            "expected x, y and z in metres. Remap `points` to a topic with a point cloud."
        )
    order = ">" if message.is_bigendian else "<"
    formats: list[str] = []
    label = fields.get(LABEL)
    # Others may mean something else by it: floats, several numbers a point.
    labelled = (
        label is not None
        and label.datatype in _WHOLE
        and label.count <= 1
        and names.count(LABEL) == 1
    )
    used = [*"xyz", *([LABEL] if labelled else [])]
    for axis in used:
        field = fields[axis]
        if field.datatype not in _TYPES:
            raise CloudError(
                f"field {axis} has the unknown datatype {field.datatype}; expected one of the "
                "constants of sensor_msgs/PointField, usually FLOAT32 (7)."
            )
        formats.append(order + _TYPES[field.datatype])
        end = field.offset + np.dtype(formats[-1]).itemsize
        if end > message.point_step:
            raise CloudError(
                f"field {axis} ends at byte {end} of a point of {message.point_step} bytes; "
                "expected point_step to cover every field. The publisher fills the message "
                "wrongly."
            )
    return np.dtype(
        {
            "names": used,
            "formats": formats,
            "offsets": [fields[axis].offset for axis in used],
        }
    )


def _named(names: list[str]) -> str:
    """Some names for a message; a client may send any number and length."""
    shown = ", ".join(name[:40] for name in sorted(names)[:10])
    return shown + (" and more" if len(names) > 10 else "") or "none"


def _checked_data(message: PointCloud2) -> memoryview:
    row = message.width * message.point_step
    # A single row needs no row_step, and some publishers leave it at 0.
    if message.height > 1 and message.row_step < row:
        raise CloudError(
            f"row_step is {message.row_step} for rows of {message.width} points of "
            f"{message.point_step} bytes; expected at least {row}. The publisher fills the "
            "message wrongly."
        )
    needed = (message.height - 1) * message.row_step + row
    if len(message.data) < needed:
        raise CloudError(
            f"the cloud's data holds {len(message.data)} bytes; expected {needed} for "
            f"{message.width} x {message.height} points of {message.point_step} bytes. The "
            "message was cut or filled wrongly."
        )
    return memoryview(message.data)


def pose_from_matrix(matrix: ArrayLike) -> Pose:
    """Return the Pose of a rigid (4, 4) matrix."""
    from megrasp_core.lie import pose7_from_matrix

    x, y, z, qx, qy, qz, qw = (
        float(v) for v in pose7_from_matrix(np.asarray(matrix, dtype=np.float64))
    )
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def numbers_from_pose(pose: Pose) -> FloatArray:
    """Return (7,): x, y, z, qx, qy, qz, qw, as they are in the message."""
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def checked_pose(numbers: ArrayLike, what: str) -> FloatArray:
    """Return the 7 numbers x, y, z, qx, qy, qz, qw of a pose, the quaternion normalised.

    Raises InvalidRequestError, which names `what`, when a number is not finite or the quaternion
    is far from unit length (10 %).
    """
    pose = np.array(numbers, dtype=np.float64)
    length = float(np.linalg.norm(pose[3:])) if pose.shape == (7,) else float("nan")
    if (
        pose.shape != (7,)
        or not (np.abs(pose) <= FARTHEST).all()
        or not np.isfinite(length)
        or abs(length - 1) > 0.1
    ):
        raise InvalidRequestError(
            f"{what} is {pose.tolist()}; expected finite x, y, z (m) and a unit quaternion qx, "
            "qy, qz, qw. The identity is 0, 0, 0, 0, 0, 0, 1."
        )
    pose[3:] /= length
    return pose


def matrix_from_numbers(numbers: ArrayLike, what: str) -> FloatArray:
    """Return the rigid (4, 4) matrix of 7 numbers; errors as those of `checked_pose`."""
    from megrasp_core.lie import matrix_from_pose7

    return matrix_from_pose7(checked_pose(numbers, what))


def matrices_from_poses(
    poses: Sequence[Pose], what: str, check: Callable[[], None] | None = None
) -> FloatArray:
    """Return the rigid matrices (N, 4, 4) of poses; errors as those of `checked_pose`.

    check: called again and again; may raise. Reading 100 000 poses takes a second.
    """
    from megrasp_core.lie import matrix_from_pose7

    rows = np.empty((len(poses), 7))
    for i, pose in enumerate(poses):
        if check is not None and i % 1000 == 0:
            check()
        p, q = pose.position, pose.orientation
        rows[i] = p.x, p.y, p.z, q.x, q.y, q.z, q.w
    length = np.linalg.norm(rows[:, 3:], axis=1)
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(rows) <= FARTHEST).all(axis=1) | ~(np.abs(length - 1) <= 0.1)
    if wrong.any():
        first = int(np.argmax(wrong))
        checked_pose(rows[first], f"{what}[{first}]")
    return matrix_from_pose7(rows)


def matrix_from_pose(pose: Pose, what: str) -> FloatArray:
    """Return the rigid (4, 4) matrix of a Pose; see `checked_pose` for the errors."""
    return matrix_from_numbers(numbers_from_pose(pose), what)


def box_from_message(message: OrientedBoxMessage, what: str = "region.pose") -> OrientedBox | None:
    """Return the box of a message, None when its size is all 0 (unset).

    Raises InvalidRequestError when the size or the pose is not usable.
    """
    from megrasp_core.pointcloud import OrientedBox

    size = np.array([message.size.x, message.size.y, message.size.z])
    if not size.any():
        return None
    box = OrientedBox(matrix_from_pose(message.pose, what), size)
    box.check_units()
    return box


def message_from_box(box: OrientedBox) -> OrientedBoxMessage:
    """Return the message of a box."""
    x, y, z = (float(v) for v in box.size)
    return OrientedBoxMessage(
        pose=pose_from_matrix(box.world_from_box), size=Vector3(x=x, y=y, z=z)
    )

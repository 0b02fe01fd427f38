"""From the frame of the cloud into the planning frame, and the direction of gravity there.

Three sources, in this order: the frames are the same; fixed extrinsics from the parameters; tf2.
tf2_ros is only imported when it is needed, since it does not exist everywhere rclpy does.
"""

from __future__ import annotations

import contextlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from megrasp_core.errors import GravityError
from megrasp_ros.conversions import matrix_from_numbers
from megrasp_ros.errors import TransformError

from .parameters import Settings

FloatArray = NDArray[np.float64]
_OPTICAL = "_optical_frame"


class TransformBuffer(Protocol):
    """What is used of tf2_ros.Buffer."""

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Time, timeout: Duration
    ) -> Any:
        """Return a geometry_msgs/TransformStamped or raise."""


def tf2_buffer(node: Node) -> TransformBuffer:
    """Return a filling tf2 buffer. Raises TransformError where tf2_ros is not installed."""
    try:
        from tf2_ros import Buffer, TransformListener
    except ImportError:
        raise TransformError(
            "planning_frame differs from the frame of the cloud, no extrinsics are given, and "
            "tf2_ros is not installed here. Set the parameter extrinsics: [x, y, z, qx, qy, qz, "
            "qw] (planning_from_cloud), or install ros-jazzy-tf2-ros-py."
        ) from None
    buffer = Buffer()
    # The listener must live as long as the buffer.
    buffer.megrasp_listener = TransformListener(buffer, node)
    return buffer


class FrameSource:
    """Answers planning_from_cloud for the header of a cloud."""

    def __init__(self, node: Node, buffer: TransformBuffer | None = None) -> None:
        """`buffer` replaces tf2's."""
        self._node = node
        self._buffer = buffer
        self.last = ""
        """What became of the last transform, for diagnostics; "" before the first."""
        self.missing = False
        """Whether it was not there."""

    def listen(self, settings: Settings) -> None:
        """Fill the buffer from now on if tf2 will be asked: the first request finds transforms
        that have been sent before it.
        """
        if self._buffer is None and settings.planning_frame and settings.extrinsics is None:
            # Where tf2_ros is missing, the request that needs it says so.
            with contextlib.suppress(TransformError):
                self._buffer = tf2_buffer(self._node)

    def planning_from_cloud(self, header: Header, settings: Settings) -> tuple[str, FloatArray]:
        """Return the name of the planning frame and the (4, 4) transform into it, at the stamp of
        the cloud.

        Raises TransformError when it is not known.
        """
        target, source = settings.planning_frame, header.frame_id
        if not target and settings.extrinsics is not None:
            raise TransformError(
                "the parameter extrinsics is given but planning_frame is empty; expected the name "
                "of the frame that the extrinsics lead to. Set planning_frame, for instance "
                "planning_frame: base_link"
            )
        if not target or target == source:
            self.last, self.missing = f"none needed, clouds come in {source!r}", False
            return source, np.eye(4)
        if settings.extrinsics is not None:
            self.last, self.missing = f"{source} -> {target} by the parameter extrinsics", False
            return target, settings.extrinsics
        self.last, self.missing = f"{source} -> {target} was not found by tf2", True
        matrix = self._from_tf2(target, source, header, settings.tf_timeout)
        self.last, self.missing = f"{source} -> {target} by tf2", False
        return target, matrix

    def _from_tf2(self, target: str, source: str, header: Header, timeout: float) -> FloatArray:
        if self._buffer is None:
            self._buffer = tf2_buffer(self._node)
        try:
            found = self._buffer.lookup_transform(
                target, source, Time.from_msg(header.stamp), Duration(seconds=timeout)
            )
        except (
            Exception
        ) as error:  # tf2's exceptions share no base class that could be imported without tf2
            raise TransformError(
                f"no transform from {source!r} to planning_frame {target!r} at the stamp of the "
                f"cloud within {timeout:g} s ({error}). Start the publisher of the camera's "
                "transform, or set the parameter extrinsics: [x, y, z, qx, qy, qz, qw] "
                "(planning_from_cloud)."
            ) from error
        t, q = found.transform.translation, found.transform.rotation
        return matrix_from_numbers(
            [t.x, t.y, t.z, q.x, q.y, q.z, q.w], f"the transform {source} -> {target}"
        )


def is_optical(frame: str) -> bool:
    """Whether a frame is a camera's by its name (REP 103): x right, y down, z forward."""
    return frame.endswith(_OPTICAL)


def gravity_in(frame: str, settings: Settings, *, optical: bool = False) -> FloatArray:
    """Return the unit vector (3,) of gravity in the planning frame `frame`.

    Without the parameter, -z; but an optical frame's z looks away from the camera, so there it
    must be given. Raises GravityError then.

    optical: the frame is known to be a camera's, whatever its name.
    """
    if settings.gravity is not None:
        return settings.gravity
    if optical or is_optical(frame):
        raise GravityError(
            f"the direction of gravity is not known: grasps are asked for in {frame!r}, an "
            "optical frame, and the parameter gravity is not set. Add the line `gravity: [0.0, "
            "0.0, 1.0]` to the parameters for a camera that looks straight down, the measured "
            "direction otherwise, or set planning_frame and extrinsics."
        )
    return np.array([0.0, 0.0, -1.0])

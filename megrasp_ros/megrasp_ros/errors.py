"""Errors that only the ROS side knows, and the place where an exception becomes an error code."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import ClassVar

from megrasp_msgs.msg import ErrorCode

from megrasp_core.errors import MegraspError
from megrasp_core.machine import is_out_of_memory


class BusyError(MegraspError):
    """Another job is running."""

    code: ClassVar[int] = ErrorCode.BUSY


class NotActiveError(MegraspError):
    """The lifecycle node is not in the state `active`."""

    code: ClassVar[int] = ErrorCode.NOT_ACTIVE


class ConfigureError(MegraspError):
    """The lifecycle node could not be configured; the code is that of the reason."""

    def __init__(self, reason: Exception) -> None:
        """Take what configuring failed with."""
        code, text = describe(reason)
        super().__init__(f"the node is not active, because configuring it failed: {text}")
        self.reason_code = code


class NoCloudError(MegraspError):
    """No cloud arrived in time."""

    code: ClassVar[int] = ErrorCode.NO_CLOUD


class StaleCloudError(MegraspError):
    """Clouds arrived, but none is young enough."""

    code: ClassVar[int] = ErrorCode.STALE_CLOUD


class TransformError(MegraspError):
    """The transform from the cloud's frame into the planning frame is not known."""

    code: ClassVar[int] = ErrorCode.TRANSFORM_OR_GRAVITY_MISSING


class SensorOriginError(MegraspError):
    """With the parameter `sensor_origin` the camera cannot have seen the cloud."""

    code: ClassVar[int] = ErrorCode.TRANSFORM_OR_GRAVITY_MISSING

    def __init__(self, origin: Sequence[float], frame: str, reason: MegraspError) -> None:
        """Take the parameter, the frame that it is in, and what the core says."""
        given = (
            f"is {' '.join(f'{value:.4g}' for value in origin)}"
            if any(origin)
            else "is not set, so that the camera is taken to be at the origin"
        )
        super().__init__(
            f"the parameter sensor_origin {given} of {shortened(frame, 80)!r}, the frame of the "
            "cloud; expected the place of the camera in that frame. Set sensor_origin: [x, y, z] "
            f"(m). If it is right: {reason}"
        )


class ToolChangeError(MegraspError):
    """The tool changer did not mount the gripper."""

    code: ClassVar[int] = ErrorCode.TOOL_CHANGE_FAILED


class NoChangerError(ToolChangeError):
    """There is no tool changer to ask, so that the tool is as it was."""


class ToolMismatchError(MegraspError):
    """The tool changer reports another tool than the active gripper."""

    code: ClassVar[int] = ErrorCode.TOOL_MISMATCH


class UnknownNameError(MegraspError):
    """No gripper of this name is registered."""

    code: ClassVar[int] = ErrorCode.UNKNOWN_GRIPPER

    def __init__(self, name: str, available: Iterable[str], *, allow_paths: bool) -> None:
        """Take the name that was given and the registered ones."""
        folder = " or the folder of a gripper.yaml" if allow_paths else ""
        super().__init__(
            f"unknown gripper {shortened(name, 80)!r}; expected one of "
            f"{', '.join(sorted(available)) or '(none found)'}{folder}. Add folders with the "
            "parameter gripper_paths."
        )


class ShortMemoryError(MegraspError):
    """Memory is not enough, however little is computed at a time."""

    code: ClassVar[int] = ErrorCode.OUT_OF_MEMORY

    def __init__(self, why: str, at_once: int) -> None:
        """Take the words of the last failure and how many poses were computed at a time."""
        super().__init__(
            f"out of memory ({why}), also with {at_once} poses at a time; expected the request to "
            "fit. Lower `drawn` or num_grasps, give a smaller region, or make room on the device."
        )


class BinEmptyError(MegraspError):
    """Only the support surface and the walls are left in the region."""

    code: ClassVar[int] = ErrorCode.BIN_EMPTY


MOST_TEXT = 1000
"""Longest text (characters) that is answered or logged: a client may send names of any length."""


def describe(error: BaseException) -> tuple[int, str]:
    """Return the error code and the text for `error_msg` of any exception of a job."""
    code, text = _describe(error)
    return code, shortened(text, MOST_TEXT)


_OPTIONS = re.compile(r" ?\((?:--sensor, the file's viewpoint|--scale(?: [\d.]+)?)\)")


def in_ros_words(text: str) -> str:
    """Return what the core says with the advice that helps here: the options of its command line
    are none of a node.
    """
    if "(--scale" in text:
        text += (
            " In ROS the driver publishes metres (REP 103); of depth images 32FC1 is in metres "
            "and 16UC1 in millimetres."
        )
    return _OPTIONS.sub("", text)


def shortened(text: str, most: int) -> str:
    """Return the text, the middle left out if it is longer than `most` characters."""
    if len(text) <= most:
        return text
    tail = most // 4
    return f"{text[: most - tail]} ({len(text) - most} characters left out) {text[-tail:]}"


def _describe(error: BaseException) -> tuple[int, str]:
    if isinstance(error, ConfigureError):
        return error.reason_code, str(error)
    if isinstance(error, MegraspError):
        return int(error.code), in_ros_words(str(error))
    if is_out_of_memory(error):
        return ErrorCode.OUT_OF_MEMORY, (
            f"out of memory ({str(error) or type(error).__name__}); expected the request to fit. "
            "Lower `drawn` or num_grasps, or give a smaller region."
        )
    return ErrorCode.INTERNAL, (
        f"unexpected {type(error).__name__}: {error}. The node goes on; its log has the details, "
        "please report it."
    )


def is_expected(error: BaseException) -> bool:
    """Return False for errors that deserve a traceback in the log."""
    return describe(error)[0] != ErrorCode.INTERNAL

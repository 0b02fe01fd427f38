"""Errors that only the ROS side knows, and the place where an exception becomes an error code."""

from __future__ import annotations

from typing import ClassVar

from megrasp_msgs.msg import ErrorCode

from megrasp_core.errors import MegraspError


class BusyError(MegraspError):
    """Another job is running."""

    code: ClassVar[int] = ErrorCode.BUSY


class NotActiveError(MegraspError):
    """The lifecycle node is not in the state `active`."""

    code: ClassVar[int] = ErrorCode.NOT_ACTIVE


class NoCloudError(MegraspError):
    """No cloud arrived in time."""

    code: ClassVar[int] = ErrorCode.NO_CLOUD


class StaleCloudError(MegraspError):
    """Clouds arrived, but none is young enough."""

    code: ClassVar[int] = ErrorCode.STALE_CLOUD


class TransformError(MegraspError):
    """The transform from the cloud's frame into the planning frame is not known."""

    code: ClassVar[int] = ErrorCode.TRANSFORM_OR_GRAVITY_MISSING


class ToolChangeError(MegraspError):
    """The tool changer did not mount the gripper."""

    code: ClassVar[int] = ErrorCode.TOOL_CHANGE_FAILED


class ToolMismatchError(MegraspError):
    """The tool changer reports another tool than the active gripper."""

    code: ClassVar[int] = ErrorCode.TOOL_MISMATCH


class BinEmptyError(MegraspError):
    """Only the support surface and the walls are left in the region."""

    code: ClassVar[int] = ErrorCode.BIN_EMPTY


def describe(error: BaseException) -> tuple[int, str]:
    """Return the error code and the text for `error_msg` of any exception of a job."""
    if isinstance(error, MegraspError):
        return int(error.code), str(error)
    # torch.OutOfMemoryError is a RuntimeError; by name, so that this module does not import torch
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
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

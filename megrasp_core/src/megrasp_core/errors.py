"""Errors a user can meet. Each says what was given, what was expected and what to do next.

`code` is the ROS error code of the error (`megrasp_msgs/msg/ErrorCode.msg`); the command line
turns every `MegraspError` into exit code 2.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar


class MegraspError(Exception):
    """Base of all errors that a caller may handle."""

    code: ClassVar[int] = 302


class InvalidRequestError(MegraspError):
    """An argument is outside its range."""

    code = 5


class SensorPlaceError(InvalidRequestError):
    """The sensor is said to be where it cannot have seen the cloud from."""


class CancelledError(MegraspError):
    """The caller cancelled the work between two steps."""

    code = 3


class RequestTimeoutError(MegraspError):
    """The work did not end within the time that the caller gave."""

    code = 4


class CloudError(MegraspError):
    """A point cloud cannot be read or holds no usable point."""

    code = 102


class GravityError(MegraspError):
    """The direction of gravity, or the transform it needs, is not known."""

    code = 103


class EmptyRegionError(MegraspError):
    """No point of the cloud lies in the region."""

    code = 104


class NoBinError(MegraspError):
    """No bin, or none of the given size, is in the cloud."""

    code = 104


class UnknownGripperError(MegraspError):
    """No gripper of this name is registered."""

    code = 200

    def __init__(self, name: str, available: Iterable[str]) -> None:
        names = sorted(available)
        super().__init__(
            f"unknown gripper {name!r}; expected one of {', '.join(names) or '(none found)'} or a "
            "folder that holds a gripper.yaml. Add folders with MEGRASP_GRIPPER_PATH."
        )
        self.available = tuple(names)


class DescriptionError(MegraspError):
    """A gripper description is wrong."""

    code = 201


class ObjectError(MegraspError):
    """An object folder is wrong or missing."""

    code = 5


class DataError(MegraspError):
    """A data folder, shard or label file is wrong or missing."""

    code = 5


class ModelError(MegraspError):
    """A model cannot be found or its files are damaged."""

    code = 300


class MissingPackageError(MegraspError):
    """A Python package that only some commands need is not installed."""

    code = 302

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"the package {package} is not installed; expected it for {purpose}. Run "
            f"`pip install 'megrasp-core[{extra}]'`."
        )
        self.package = package


class TrainingError(MegraspError):
    """A training run cannot go on."""

    code = 302


class SimulationError(MegraspError):
    """The simulation went unstable or cannot be built."""

    code = 302

"""The wizard: a description for a gripper from its URDF or MJCF, by moving the joints."""

from .analyse import Analysis, Overrides
from .findings import Finding
from .source import SourceOptions
from .wizard import ModelRequest, NewGripper, new_gripper

__all__ = [
    "Analysis",
    "Finding",
    "NewGripper",
    "Overrides",
    "ModelRequest",
    "SourceOptions",
    "new_gripper",
]

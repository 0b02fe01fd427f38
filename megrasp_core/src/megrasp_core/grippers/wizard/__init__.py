"""The wizard: a description for a gripper from its URDF or MJCF, by moving the joints."""

from megrasp_core.grippers.wizard.analyse import Analysis, Overrides, analyse
from megrasp_core.grippers.wizard.findings import Finding
from megrasp_core.grippers.wizard.prepare import SourceOptions, prepare
from megrasp_core.grippers.wizard.wizard import NewGripper, Request, new_gripper

__all__ = [
    "Analysis",
    "Finding",
    "NewGripper",
    "Overrides",
    "Request",
    "SourceOptions",
    "analyse",
    "new_gripper",
    "prepare",
]

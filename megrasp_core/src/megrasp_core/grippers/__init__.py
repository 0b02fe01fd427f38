"""Grippers: descriptions, URDF/MJCF loading, postures, renderer, registry (DESIGN section 4)."""

from megrasp_core.grippers.check import GripperCheck, check_gripper
from megrasp_core.grippers.clouds import GripperClouds, GripperTokens
from megrasp_core.grippers.compare import Comparison, compare, opening
from megrasp_core.grippers.description import (
    Actuation,
    GripperDescription,
    Pose,
    PostureDescription,
    load_description,
    save_description,
)
from megrasp_core.grippers.gripper import Gripper
from megrasp_core.grippers.picture import gripper_picture
from megrasp_core.grippers.registry import (
    cad_folders,
    cad_twins,
    gripper_folders,
    list_grippers,
    load_gripper,
)
from megrasp_core.grippers.render import render_cloud
from megrasp_core.grippers.symmetry import symmetry_residual

__all__ = [
    "Actuation",
    "Comparison",
    "Gripper",
    "GripperCheck",
    "GripperClouds",
    "GripperDescription",
    "GripperTokens",
    "Pose",
    "PostureDescription",
    "cad_folders",
    "cad_twins",
    "check_gripper",
    "compare",
    "gripper_folders",
    "gripper_picture",
    "list_grippers",
    "load_description",
    "load_gripper",
    "opening",
    "render_cloud",
    "save_description",
    "symmetry_residual",
]

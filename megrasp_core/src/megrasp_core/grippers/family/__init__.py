"""The procedural family: grippers drawn at random, so that networks learn geometry, not names."""

from megrasp_core.grippers.family.parameters import FamilyParameters, draw_parameters
from megrasp_core.grippers.family.rack import (
    is_procedural,
    load_procedural,
    procedural_gripper_name,
    procedural_rack,
)
from megrasp_core.grippers.family.ranges import FAMILY_KINDS, RANGES
from megrasp_core.grippers.family.sample import build_gripper, sample_gripper
from megrasp_core.grippers.family.writing import is_whole, write_gripper

__all__ = [
    "FAMILY_KINDS",
    "RANGES",
    "FamilyParameters",
    "build_gripper",
    "draw_parameters",
    "is_procedural",
    "is_whole",
    "load_procedural",
    "procedural_gripper_name",
    "procedural_rack",
    "sample_gripper",
    "write_gripper",
]

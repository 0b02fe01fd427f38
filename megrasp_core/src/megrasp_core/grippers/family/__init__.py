"""The procedural family: grippers drawn at random, so that networks learn geometry, not names."""

from .draw import draw_parameters
from .parameters import FamilyParameters
from .rack import is_procedural, load_procedural, procedural_gripper_name, procedural_rack
from .ranges import FAMILY_KINDS, RANGES
from .sample import build_gripper, sample_gripper
from .writing import is_whole, write_gripper

__all__ = [
    "FAMILY_KINDS",
    "FamilyParameters",
    "RANGES",
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

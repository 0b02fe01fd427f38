"""The grasp library: grasps of single objects, tried in free space, for every gripper."""

from .candidates import Candidates, CandidateSettings, ObjectSurface, antipodal
from .card import library_card
from .check import verify_library
from .facts import ObjectFacts, library_stats, object_facts
from .grasp_library import (
    GraspLibrary,
    continue_library,
    load_library,
    pack_library,
    write_grasp_set,
)
from .labelling import LabelSettings, LibraryConfig, cached_gripper, generate_library, label_object

__all__ = [
    "CandidateSettings",
    "Candidates",
    "GraspLibrary",
    "LabelSettings",
    "LibraryConfig",
    "ObjectFacts",
    "ObjectSurface",
    "antipodal",
    "cached_gripper",
    "continue_library",
    "generate_library",
    "label_object",
    "library_card",
    "library_stats",
    "load_library",
    "object_facts",
    "pack_library",
    "verify_library",
    "write_grasp_set",
]

"""Grippers: descriptions, URDF/MJCF loading, postures, renderer, registry (docs/architecture.md,
"Grippers").
"""

from .actuation import free_name
from .clouds import NEAR_TCP, GripperClouds, GripperTokens, make_clouds, surface_points
from .description import (
    FILE_NAME,
    KINDS,
    Actuation,
    GripperDescription,
    Pose,
    PostureDescription,
    load_description,
    save_description,
)
from .family.rack import is_procedural, procedural_gripper_name, procedural_rack
from .family.sample import sample_gripper
from .family.writing import is_whole, write_gripper
from .geometry import BodyMesh, body_meshes, body_poses
from .gripper import POSTURES, Gripper
from .model import (
    COLLISION_GROUP,
    COUPLING_SOLREF,
    ROOT_BODY,
    SOLIMP,
    URDF_ARMATURE,
    VISUAL_GROUP,
    build_spec,
    compile_spec,
    quiet_mujoco,
)
from .model_file import MODEL_SUFFIXES, read_xml
from .model_mistakes import NO_SUCTION, check_names, check_spec, check_tree
from .posture import SETTLE_DAMPING
from .registry import cad_folders, cad_twins, gripper_folders, list_grippers, load_gripper
from .render import render_cloud
from .stroke import Stroke

__all__ = [
    "Actuation",
    "BodyMesh",
    "COLLISION_GROUP",
    "COUPLING_SOLREF",
    "FILE_NAME",
    "Gripper",
    "GripperClouds",
    "GripperDescription",
    "GripperTokens",
    "KINDS",
    "MODEL_SUFFIXES",
    "NEAR_TCP",
    "NO_SUCTION",
    "POSTURES",
    "Pose",
    "PostureDescription",
    "ROOT_BODY",
    "SETTLE_DAMPING",
    "SOLIMP",
    "Stroke",
    "URDF_ARMATURE",
    "VISUAL_GROUP",
    "body_meshes",
    "body_poses",
    "build_spec",
    "cad_folders",
    "cad_twins",
    "check_names",
    "check_spec",
    "check_tree",
    "compile_spec",
    "free_name",
    "gripper_folders",
    "is_procedural",
    "is_whole",
    "list_grippers",
    "load_description",
    "load_gripper",
    "make_clouds",
    "procedural_gripper_name",
    "procedural_rack",
    "quiet_mujoco",
    "read_xml",
    "render_cloud",
    "sample_gripper",
    "save_description",
    "surface_points",
    "write_gripper",
]

"""Objects to grasp: the model, its folder format, procedural kinds, outside object sets."""

from megrasp_core.objects.assets import (
    SPLITS,
    TRAIN_SETS,
    asset_objects,
    is_validation,
    load_asset_objects,
)
from megrasp_core.objects.folder import find_objects, load_object, load_objects, save_object
from megrasp_core.objects.kinds import OBJECT_KINDS, OBSTACLE_KINDS, object_kind
from megrasp_core.objects.model import ConvexPiece, ObjectModel
from megrasp_core.objects.procedural import generate_objects, procedural_object

__all__ = [
    "OBJECT_KINDS",
    "OBSTACLE_KINDS",
    "SPLITS",
    "TRAIN_SETS",
    "ConvexPiece",
    "ObjectModel",
    "asset_objects",
    "find_objects",
    "generate_objects",
    "is_validation",
    "load_asset_objects",
    "load_object",
    "load_objects",
    "object_kind",
    "procedural_object",
    "save_object",
]

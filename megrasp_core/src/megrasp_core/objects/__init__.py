"""Objects to grasp: the model, its folder format, procedural kinds, outside object sets."""

from .assets import SPLITS, TRAIN_SETS, asset_objects, is_validation, load_asset_objects
from .folder import find_objects, load_object, load_objects, save_object
from .kinds import OBJECT_KINDS, OBSTACLE_KINDS, object_kind
from .model import ConvexPiece, ObjectModel
from .object_set import (
    ObjectSet,
    asset_names,
    balanced_shares,
    obstacle_name,
    procedural_names,
    training_objects,
    validation_objects,
)
from .procedural import generate_objects, procedural_object
from .solids import Solid, box, mass_properties, stack

__all__ = [
    "ConvexPiece",
    "OBJECT_KINDS",
    "OBSTACLE_KINDS",
    "ObjectModel",
    "ObjectSet",
    "SPLITS",
    "Solid",
    "TRAIN_SETS",
    "asset_names",
    "asset_objects",
    "balanced_shares",
    "box",
    "find_objects",
    "generate_objects",
    "is_validation",
    "load_asset_objects",
    "load_object",
    "load_objects",
    "mass_properties",
    "object_kind",
    "obstacle_name",
    "procedural_names",
    "procedural_object",
    "save_object",
    "stack",
    "training_objects",
    "validation_objects",
]

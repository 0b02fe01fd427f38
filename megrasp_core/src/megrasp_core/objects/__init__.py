"""Objects to grasp: the model, its folder format, procedural kinds, objects from meshes, outside
object sets.
"""

from .assets import SPLITS, TRAIN_SETS, asset_objects, is_validation
from .decomposition import Decomposition, Method, decompose
from .folder import find_objects, load_object, load_objects, save_object
from .kinds import OBJECT_KINDS, OBSTACLE_KINDS, object_kind
from .mesh_files import MeshFile, mesh_files, read_mesh
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
from .preparation import (
    DEFAULT_DENSITY,
    Prepared,
    PrepareSettings,
    PrepareSummary,
    prepare_object,
    prepare_objects,
)
from .procedural import generate_objects, procedural_object
from .seeds import ObjectSeeds
from .solids import Solid, box, mass_properties, stack, volume_of
from .stretched import source_of, stretched, stretched_name

__all__ = [
    "ConvexPiece",
    "DEFAULT_DENSITY",
    "Decomposition",
    "MeshFile",
    "Method",
    "OBJECT_KINDS",
    "OBSTACLE_KINDS",
    "ObjectModel",
    "ObjectSeeds",
    "ObjectSet",
    "PrepareSettings",
    "PrepareSummary",
    "Prepared",
    "SPLITS",
    "Solid",
    "TRAIN_SETS",
    "asset_names",
    "asset_objects",
    "balanced_shares",
    "box",
    "decompose",
    "find_objects",
    "generate_objects",
    "is_validation",
    "load_object",
    "load_objects",
    "mass_properties",
    "mesh_files",
    "object_kind",
    "obstacle_name",
    "prepare_object",
    "prepare_objects",
    "procedural_names",
    "procedural_object",
    "read_mesh",
    "save_object",
    "source_of",
    "stack",
    "stretched",
    "stretched_name",
    "training_objects",
    "validation_objects",
    "volume_of",
]

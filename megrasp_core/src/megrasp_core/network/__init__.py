"""SE(3)-equivariant network: scene encoder, gripper encoder, decoder and heads."""

from .config import PRESETS, ModelConfig
from .default_models import DefaultModels
from .graph import SceneGraph, build_graph, graph_sizes
from .gripper_encoder import GripperCode
from .info import ModelInfo
from .model import GraspModel, Prediction
from .precision import low_precision_pays
from .scene_encoder import SceneField
from .storage import (
    default_model,
    find_model,
    list_models,
    load_model,
    model_folders,
    move_to,
    save_model,
)

__all__ = [
    "DefaultModels",
    "GraspModel",
    "GripperCode",
    "ModelConfig",
    "ModelInfo",
    "PRESETS",
    "Prediction",
    "SceneField",
    "SceneGraph",
    "build_graph",
    "default_model",
    "find_model",
    "graph_sizes",
    "list_models",
    "load_model",
    "low_precision_pays",
    "model_folders",
    "move_to",
    "save_model",
]

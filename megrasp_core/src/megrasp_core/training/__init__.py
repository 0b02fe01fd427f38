"""Training: batches, losses, loop, validation, checkpoints that resume, fine-tuning."""

from .batching import LabelledPoses, SceneBatch, SceneSource, balance, scene_batch
from .config import GRIPPERS, Counters, TrainConfig, rate_factor
from .finetune import FEW, FinetuneConfig, FinetuneResult, finetune
from .given_grasps import GivenGrasp, GivenScene, doubt, given_scene
from .job import TrainingJob
from .loop import TrainingRun
from .losses import scene_losses
from .processes import Team
from .rack import GripperRack
from .scenes import (
    PoseTable,
    TrainingEntry,
    divided,
    is_held_out,
    read_entries,
    scene_keys,
    without_objects,
)
from .start import resume_training, train
from .validation import ValidationResult, validate, validation_pairs

__all__ = [
    "Counters",
    "FEW",
    "FinetuneConfig",
    "FinetuneResult",
    "GRIPPERS",
    "GivenGrasp",
    "GivenScene",
    "GripperRack",
    "LabelledPoses",
    "PoseTable",
    "SceneBatch",
    "SceneSource",
    "Team",
    "TrainConfig",
    "TrainingEntry",
    "TrainingJob",
    "TrainingRun",
    "ValidationResult",
    "balance",
    "divided",
    "doubt",
    "finetune",
    "given_scene",
    "is_held_out",
    "rate_factor",
    "read_entries",
    "resume_training",
    "scene_batch",
    "scene_keys",
    "scene_losses",
    "train",
    "validate",
    "validation_pairs",
    "without_objects",
]

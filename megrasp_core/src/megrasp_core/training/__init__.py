"""Training: batches, losses, loop, checkpoints that resume, loss curves."""

from .batching import LabelledPoses, SceneBatch, SceneSource, balance, record_nodes
from .config import Counters, TrainConfig
from .loop import train
from .losses import scene_losses

__all__ = [
    "Counters",
    "LabelledPoses",
    "SceneBatch",
    "SceneSource",
    "TrainConfig",
    "balance",
    "record_nodes",
    "scene_losses",
    "train",
]

"""Hyper-parameters of training."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from ..errors import InvalidRequestError
from ..network import PRESETS, ModelConfig


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """What a training run does; stored in its checkpoint."""

    preset: str = "small"
    """Size of the network: tiny, small or base."""
    model_id: str = "megrasp-small"
    grippers: tuple[str, ...] = ("robotiq_2f85", "franka_hand", "robotiq_3f")
    scenes_per_step: int = 1
    poses_per_gripper: int = 128
    """Noisy poses per gripper, scene and step."""
    learning_rate: float = 1e-3
    weight_decay: float = 1e-3
    warmup_steps: int = 100
    decay_share: float = 0.35
    """Last share of the run in which the learning rate falls to 2 %."""
    ema_decay: float = 0.999
    gradient_clip: float = 1.0
    total_poses: int | None = None
    """End after this many noisy poses."""
    total_seconds: float | None = 3600.0
    """Or after this much training time, resumed runs included."""
    gravity_dropout: float = 0.1
    point_jitter: float = 0.0005
    """Standard deviation (m) of noise added to the nodes."""
    score_weight: float = 0.1
    graspability_weight: float = 0.1
    graspability_radius: float = 0.02
    """A node within this distance (m) of a positive's TCP counts as graspable."""
    confidence_weight: float = 0.1
    confidence_poses: int = 32
    """Labelled poses per gripper, scene and step, half of them failures where there are enough."""
    object_balanced: bool = True
    validation_scenes: int = 16
    checkpoint_seconds: float = 180.0
    low_precision: bool = True
    """bfloat16 in the token part."""
    train_only: Literal["all", "heads"] = "all"
    """`heads`: only confidence and graspability; the diffusion stays as it is."""
    seed: int = 1

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise InvalidRequestError(
                f"network preset {self.preset!r} is unknown; expected one of {sorted(PRESETS)}."
            )
        if self.total_poses is None and self.total_seconds is None:
            raise InvalidRequestError(
                "neither total_poses nor total_seconds was given; expected at least one end of "
                "the run."
            )

    @property
    def network(self) -> ModelConfig:
        """Sizes of the network."""
        return PRESETS[self.preset]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TrainConfig:
        """Inverse of `to_dict`."""
        lists: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values.items()
        }
        return cls(**lists)


@dataclasses.dataclass
class Counters:
    """Honest counts of what a model has seen, kept across resumes."""

    steps: int = 0
    poses: int = 0
    """Noisy poses that went into the diffusion loss."""
    labelled_poses: int = 0
    """Poses that went into the confidence loss."""
    scenes: int = 0
    """Scene encodings, repeats counted."""
    seconds: float = 0.0
    """Wall time of training steps."""
    cpu_seconds: float = 0.0

    def progress(self, config: TrainConfig) -> float:
        """Share of the run that is done, 0 to 1."""
        shares = []
        if config.total_poses is not None:
            shares.append(self.poses / config.total_poses)
        if config.total_seconds is not None:
            shares.append(self.seconds / config.total_seconds)
        return min(1.0, max(shares))

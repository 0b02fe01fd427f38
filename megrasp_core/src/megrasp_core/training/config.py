"""Hyper-parameters of training."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.network import PRESETS, ModelConfig
from megrasp_core.ranges import (
    COUNT,
    FROM_ONE,
    LENGTH,
    POSITIVE,
    SHARE,
    WEIGHT,
    Range,
    check_ranges,
)

GRIPPERS = (
    "robotiq_2f85",
    "franka_hand",
    "google_gripper",
    "rethink_gripper",
    "vx300s_gripper",
    "robotiq_3f",
    "allegro_hand",
    "shadow_dexee",
    "shadow_hand",
    "shadow_hand_3f",
    "shadow_hand_2f",
)
"""The grippers that models are trained for; the others are never seen in training."""

WARMUP_SHARE = 0.05
"""The rate rises for this share of the plan at most: short plans have few steps."""


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """What a training run does; stored in its checkpoint, from which alone it goes on."""

    network: ModelConfig = PRESETS["small"]
    """Sizes of the network."""
    model_id: str = "unnamed"
    """Name of the model that comes out."""
    grippers: tuple[str, ...] = GRIPPERS
    """Names of the grippers to learn."""
    procedural_share: float = 0.25
    """Share of the scenes that are drawn for a procedural gripper, where the data holds any."""
    hand_weight: float = 1.5
    """How often a scene is drawn for a hand for every time that one is for another gripper."""
    total_poses: int = 3_000_000
    """Noisy poses of the whole plan, however many stretches it takes; in training of the heads,
    labelled poses. The learning rate follows this count."""
    scenes_per_step: int = 1
    """Scenes whose gradients are averaged in a step."""
    poses_per_scene: int = 160
    """Noisy poses per scene and step, shared evenly by its grippers."""
    grippers_per_scene: int = 4
    """At most so many grippers of a scene are taken in a step."""
    learning_rate: float = 1e-3
    """Highest learning rate."""
    weight_decay: float = 1e-3
    """Of AdamW."""
    warmup_steps: int = 500
    """Steps in which the learning rate rises from 0; at most a twentieth of the plan."""
    constant_share: float = 0.4
    """Share of the plan after which the learning rate falls, linearly, to 0."""
    ema_decay: float = 0.9995
    """Decay a step of the averaged weights, which are the model that comes out."""
    gradient_clip: float = 1.0
    """Longest gradient."""
    gravity_dropout: float = 0.1
    """Share of the scenes whose gravity is left unknown."""
    point_jitter: float = 0.0005
    """Standard deviation (m) of noise added to the points."""
    node_sets: int = 4
    """Random choices of nodes, with their graphs, that are made and kept of a scene."""
    low_levels: float | None = None
    """Share of the noise levels below `LOW_LEVEL`; by default what log-uniform levels give."""
    nearest_copy: bool = False
    """For n-fold grippers the target is the symmetric copy nearest to the noisy pose, not the mean
    of all."""
    score_weight: float = 0.1
    """Weight of the rotation score's loss."""
    graspability_weight: float = 0.1
    """Weight of the graspability's loss."""
    graspability_radius: float = 0.02
    """A node within this distance (m) of a positive's TCP counts as graspable."""
    tried_radius: float = 0.03
    """A node farther (m) than this from every label's TCP is on an object that nobody tried: it
    counts neither as graspable nor as not, unless it lies on the support plane."""
    confidence_weight: float = 0.1
    """Weight of the confidence's loss."""
    confidence_every: int = 2
    """The confidence is trained in every so many steps."""
    confidence_poses: int = 96
    """Labelled poses per scene and step, half of them failures where there are enough."""
    object_balanced: bool = True
    """Objects of a scene have equal shares in its poses."""
    rare_objects: float = 0.0
    """Objects that are in few scenes get more of the poses: 0, as many as they have scenes; 1, all
    objects as many; 0.5, by the square root of their scenes."""
    validation_pairs: int = 6
    """Scenes per gripper that validate."""
    validation_poses: int = 48
    """Noisy poses per gripper and scene in validation."""
    checkpoint_seconds: float = 600.0
    """Time between checkpoints."""
    sampler: SamplerSettings = dataclasses.field(default_factory=SamplerSettings)
    """How the model is meant to be sampled, written into its `config.json`."""
    train_only: Literal["all", "heads"] = "all"
    """`heads`: only confidence and graspability; the diffusion stays as it is."""
    seed: int = 1
    """Of weights, scenes, poses and noise."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            procedural_share=Range(0, below=1),
            hand_weight=WEIGHT,
            total_poses=FROM_ONE,
            scenes_per_step=FROM_ONE,
            poses_per_scene=FROM_ONE,
            grippers_per_scene=FROM_ONE,
            learning_rate=POSITIVE,
            weight_decay=WEIGHT,
            warmup_steps=COUNT,
            constant_share=Range(0, below=1),
            ema_decay=Range(0, below=1),
            gradient_clip=POSITIVE,
            gravity_dropout=SHARE,
            point_jitter=LENGTH,
            node_sets=FROM_ONE,
            low_levels=Range(0, below=1, optional=True),
            score_weight=WEIGHT,
            graspability_weight=WEIGHT,
            graspability_radius=LENGTH,
            tried_radius=LENGTH,
            confidence_weight=WEIGHT,
            confidence_every=FROM_ONE,
            confidence_poses=COUNT,
            rare_objects=SHARE,
            validation_pairs=COUNT,
            validation_poses=COUNT,
            checkpoint_seconds=LENGTH,
            seed=COUNT,
        )
        if self.heads_only and self.confidence_weight * self.confidence_poses <= 0:
            raise InvalidRequestError(
                f"training of the heads alone was given with confidence_weight "
                f"{self.confidence_weight} and confidence_poses {self.confidence_poses}; expected "
                "both above 0."
            )

    @property
    def heads_only(self) -> bool:
        """Whether the diffusion stays as it is."""
        return self.train_only == "heads"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TrainConfig:
        """Inverse of `to_dict`.

        Raises:
            DataError: fields that this version does not know.
        """
        names = {field.name for field in dataclasses.fields(cls)}
        unknown = sorted(set(values) - names)
        if unknown:
            raise DataError(
                f"the training config has unknown fields {unknown}; expected some of "
                f"{sorted(names)}. It was written by another version: go on with that one, or "
                "start a new run."
            )
        plain: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
        }
        plain["network"] = ModelConfig.from_dict(plain["network"])
        plain["sampler"] = SamplerSettings(**plain["sampler"])
        return cls(**plain)


@dataclasses.dataclass
class Counters:
    """Honest counts of what a model has seen, kept across resumes."""

    steps: int = 0
    """Optimiser steps."""
    poses: int = 0
    """Noisy poses that went into the diffusion loss."""
    labelled_poses: int = 0
    """Poses that went into the confidence loss."""
    scenes: int = 0
    """Scene encodings, repeats counted."""
    seconds: float = 0.0
    """Wall time of training steps."""
    cpu_seconds: float = 0.0
    """CPU time of training steps, all processes together."""
    stretches: int = 0
    """How often the run was started or resumed."""
    skipped: int = 0
    """Steps whose gradient was no finite number; they changed nothing and count no poses."""

    def planned(self, config: TrainConfig) -> int:
        """The poses that the plan counts, so far."""
        return self.labelled_poses if config.heads_only else self.poses

    def progress(self, config: TrainConfig) -> float:
        """Share of the plan that is done, 0 to 1."""
        return min(1.0, self.planned(config) / config.total_poses)


def rate_factor(counters: Counters, config: TrainConfig) -> float:
    """Learning rate as a share of the highest: warm-up, constant, linear to 0; by what was seen
    and not by the clock, so that a busy machine trains the same model.
    """
    steps = (counters.steps + 1) / max(1, config.warmup_steps)
    warm = min(1.0, max(steps, counters.progress(config) / WARMUP_SHARE))
    left = (1.0 - counters.progress(config)) / (1.0 - config.constant_share)
    return warm * min(1.0, left)

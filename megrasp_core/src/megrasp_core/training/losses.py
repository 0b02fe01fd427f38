"""Losses of one scene: diffusion, rotation score, confidence, graspability."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from ..diffusion import NoiseSchedule, perturb, score_target, target
from ..network import GraspModel, GripperCode, SceneField
from .batching import LabelledPoses, SceneBatch
from .config import TrainConfig


def draw_levels(
    count: int, s_min: float, generator: torch.Generator, device: torch.device
) -> Tensor:
    """Noise levels `(count,)`, log s uniform in [log s_min, 0], stratified."""
    jitter = torch.rand(count, generator=generator, device=device)
    uniform = (torch.arange(count, device=device) + jitter) / count
    return torch.exp(math.log(s_min) * uniform)


def diffusion_losses(
    model: GraspModel,
    field: SceneField,
    code: GripperCode,
    poses: LabelledPoses,
    schedule: NoiseSchedule,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Mean |F - y|^2 over the residual, and the same for the rotation score (DESIGN section 6)."""
    rotation, translation = poses.rotation.to(model.device), poses.translation.to(model.device)
    s = draw_levels(len(rotation), model.config.s_min, generator, model.device)
    noisy_rotation, noisy_translation = perturb(rotation, translation, s, schedule, generator)
    y = target(rotation, translation, noisy_rotation, noisy_translation, s, schedule)
    score = score_target(rotation, noisy_rotation, s, schedule)
    prediction = model.predict(field, code, noisy_rotation, noisy_translation, s)
    return (
        (prediction.residual - y).square().mean(),
        (prediction.score - score).square().mean(),
    )


def scene_losses(
    model: GraspModel,
    codes: dict[str, GripperCode],
    batch: SceneBatch,
    config: TrainConfig,
    schedule: NoiseSchedule,
    generator: torch.Generator,
) -> tuple[Tensor, dict[str, float]]:
    """Weighted sum of all losses of one scene and their values by name."""
    field = model.encode_scene(batch.nodes, batch.graph)
    total = torch.zeros((), device=model.device)
    parts: dict[str, list[float]] = {}

    def add(name: str, value: Tensor, weight: float, share: int) -> None:
        nonlocal total
        total = total + weight * value / share
        parts.setdefault(name, []).append(float(value.detach()))

    if config.train_only == "all":
        for gripper, poses in batch.positives.items():
            residual, score = diffusion_losses(
                model, field, codes[gripper], poses, schedule, generator
            )
            add("diffusion", residual, 1.0, len(batch.positives))
            add("score", score, config.score_weight, len(batch.positives))
    for gripper, poses in batch.labelled.items():
        if config.confidence_weight and len(poses.label):
            logit = model.confidence(
                field, codes[gripper], poses.rotation.to(model.device),
                poses.translation.to(model.device),
            )  # fmt: skip
            label = poses.label.to(model.device)
            loss = functional.binary_cross_entropy_with_logits(logit, label)
            add("confidence", loss, config.confidence_weight, len(batch.labelled))
    for gripper, centres in batch.centres.items():
        if config.graspability_weight:
            loss = graspability_loss(model, field, codes[gripper], centres, config)
            add("graspability", loss, config.graspability_weight, len(batch.centres))
    return total, {name: sum(values) / len(values) for name, values in parts.items()}


def graspability_loss(
    model: GraspModel, field: SceneField, code: GripperCode, centres: Tensor, config: TrainConfig
) -> Tensor:
    """Cross-entropy of "a positive's TCP is near this node" over the nodes of the second level."""
    logit = model.graspability(field, code)
    if len(centres):
        distance = torch.cdist(field.points[1], centres.to(model.device)).amin(1)
        near = (distance < config.graspability_radius).to(logit.dtype)
    else:
        near = torch.zeros_like(logit)
    return functional.binary_cross_entropy_with_logits(logit, near)

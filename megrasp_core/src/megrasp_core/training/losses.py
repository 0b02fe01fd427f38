"""Losses of one scene: diffusion, rotation score, confidence, graspability."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn import functional

from megrasp_core.diffusion import NoiseSchedule, perturb, score_target, target
from megrasp_core.lie import PoseBatch, so3
from megrasp_core.network import GraspModel, GripperCode, SceneField

from .batching import LabelledPoses, SceneBatch
from .config import TrainConfig


@dataclasses.dataclass(frozen=True)
class SceneLosses:
    """Losses of one scene.

    Attributes:
        total: weighted sum, to be descended.
        values: by name, unweighted.
        level: `(P,)` noise level and
        residual: `(P,)` squared error, mean over the six components, of each noisy pose, in the
            order of `owners`.
        owners: gripper and number of noisy poses.
    """

    total: Tensor
    values: dict[str, float]
    level: Tensor
    residual: Tensor
    owners: tuple[tuple[str, int], ...]


def nearest_copies(rotation: Tensor, noisy: Tensor, fold: Tensor) -> Tensor:
    """Of each pose the copy, turned about its own +Z, that is nearest to its noisy pose.

    An n-fold gripper looks the same after a turn by 2 pi / n about the TCP's +Z, so any copy is
    as good a target; their mean, which a residual learns otherwise, is none.

    Args:
        rotation: `(P, 3, 3)` R_0.
        noisy: `(P, 3, 3)` R_s.
        fold: `(P,)` n.
    """
    # Trace of R_s^T R_0 Rz(a) is A cos a + B sin a + c: the best a in closed form, then rounded.
    relative = noisy.transpose(-1, -2) @ rotation
    along = relative[..., 0, 0] + relative[..., 1, 1]
    across = relative[..., 0, 1] - relative[..., 1, 0]
    step = 2.0 * math.pi / fold
    angle = torch.round(torch.atan2(across, along) / step) * step
    turn = torch.zeros(len(rotation), 3, dtype=rotation.dtype, device=rotation.device)
    turn[:, 2] = angle
    return rotation @ so3.exp(turn)


@dataclasses.dataclass(frozen=True)
class Denoising:
    """Errors of the network's predictions for noisy poses.

    Attributes:
        residual: `(P,)` squared error of the residual, mean over its six components.
        score: `(P,)` squared error of the rotation score, mean over its three.
    """

    residual: Tensor
    score: Tensor


def denoising(
    model: GraspModel,
    field: SceneField,
    code: GripperCode,
    clean: PoseBatch,
    level: Tensor,
    schedule: NoiseSchedule,
    generator: torch.Generator,
    fold: Tensor | None = None,
) -> Denoising:
    """Put noise on poses and see how far the network is from taking it off again.

    Args:
        model: to be trained.
        field: the scene.
        code: of the poses' grippers.
        clean: P, scene_from_tcp.
        level: `(P,)` of noise.
        schedule: noise.
        generator: of the noise.
        fold: `(P,)` symmetries, where the copy nearest to the noisy pose is the target.
    """
    noisy = perturb(clean, level, schedule, generator)
    aim = clean
    if fold is not None:
        nearest = nearest_copies(clean.rotation, noisy.rotation, fold)
        aim = PoseBatch(nearest, clean.translation)
    prediction = model.predict(field, code, noisy, level)
    y = target(aim, noisy, level, schedule)
    score = score_target(clean, noisy, level, schedule)
    return Denoising(
        (prediction.residual - y).square().mean(-1), (prediction.score - score).square().mean(-1)
    )


def scene_losses(
    model: GraspModel,
    codes: Mapping[str, GripperCode],
    batch: SceneBatch,
    config: TrainConfig,
    schedule: NoiseSchedule,
    generator: torch.Generator,
    folds: Mapping[str, int] | None = None,
) -> SceneLosses:
    """All losses of one scene.

    Args:
        model: to be trained.
        codes: of the batch's grippers.
        batch: the scene.
        config: weights.
        schedule: noise.
        generator: of levels and noise.
        folds: gripper -> n-fold symmetry, for `config.nearest_copy`.
    """
    field = model.encode_scene(batch.nodes, batch.graph)
    device = model.device
    terms: dict[str, Tensor] = {}
    level = residual = torch.zeros(0, device=device)
    if batch.positives:
        poses, code = _joined(batch.positives, codes, device)
        fold = torch.cat(
            [
                torch.full((len(part),), (folds or {}).get(name, 1), device=device)
                for name, part in batch.positives.items()
            ]
        )
        # Levels are even within each gripper, whose share of the poses is small.
        level = torch.cat(
            [
                schedule.random_levels(
                    len(part), generator, low_share=config.low_levels, device=device
                )
                for part in batch.positives.values()
            ]
        )
        found = denoising(
            model,
            field,
            code,
            poses.poses,
            level,
            schedule,
            generator,
            fold if config.nearest_copy else None,
        )
        residual = found.residual
        terms["diffusion"] = residual.mean()
        terms["score"] = found.score.mean()
    if batch.labelled:
        poses, code = _joined(batch.labelled, codes, device)
        logit = model.confidence(field, code, poses.poses)
        terms["confidence"] = functional.binary_cross_entropy_with_logits(logit, poses.target)
    if config.graspability_weight:
        parts = [
            graspability_loss(
                model, field, codes[name], near.to(device), batch.tried[name].to(device), config
            )
            for name, near in batch.graspable.items()
        ]
        terms["graspability"] = torch.stack(parts).mean()
    weights = {
        "diffusion": 1.0,
        "score": config.score_weight,
        "confidence": config.confidence_weight,
        "graspability": config.graspability_weight,
    }
    total = torch.zeros((), device=device)
    for name, term in terms.items():
        total = total + weights[name] * term
    return SceneLosses(
        total,
        {name: float(term.detach()) for name, term in terms.items()},
        level,
        residual.detach(),
        tuple((name, len(part)) for name, part in batch.positives.items()),
    )


def _joined(
    parts: Mapping[str, LabelledPoses], codes: Mapping[str, GripperCode], device: torch.device
) -> tuple[LabelledPoses, GripperCode]:
    """The poses of all grippers one after another, and the gripper of each."""
    poses = LabelledPoses(
        PoseBatch.joined([part.poses for part in parts.values()]).to(device),
        torch.cat([part.target for part in parts.values()]).to(device),
    )
    counts = [len(part) for part in parts.values()]
    return poses, GripperCode.of_poses([codes[name] for name in parts], counts)


def graspability_loss(
    model: GraspModel,
    field: SceneField,
    code: GripperCode,
    graspable: Tensor,
    tried: Tensor,
    config: TrainConfig,
) -> Tensor:
    """Cross-entropy of "a positive's TCP is near this node" over the nodes of the second level.

    Nodes on objects that nobody tried say nothing and are left out; the support plane is known
    not to be graspable.

    Args:
        model: to be trained.
        field: the scene.
        code: the gripper.
        graspable: `(K, 3)` TCPs of the grasps that held (m).
        tried: `(L, 3)` TCPs of all that was tried.
        config: radii.
    """
    points = field.points[1]
    near = _nearest(points, graspable) < config.graspability_radius
    known = near | (_nearest(points, tried) < config.tried_radius) | field.coarse_plane
    if not bool(known.any()):
        return field.invariants.new_zeros(())
    logit = model.graspability(field, code)
    return functional.binary_cross_entropy_with_logits(logit[known], near[known].to(logit.dtype))


def _nearest(points: Tensor, centres: Tensor) -> Tensor:
    """Distance `(n,)` (m) from points `(n, 3)` to the nearest centre; infinite without centres."""
    if not len(centres):
        return torch.full((len(points),), math.inf, device=points.device)
    return torch.cdist(points, centres).amin(1)

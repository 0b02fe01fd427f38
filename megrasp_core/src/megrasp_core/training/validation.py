"""Validation on held-out objects: losses per gripper and per band of noise, the same poses and
noise every time.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from megrasp_core.diffusion import LOW_LEVEL, NoiseSchedule
from megrasp_core.grippers import GripperTokens, is_procedural
from megrasp_core.network import GraspModel
from megrasp_core.pointcloud import SceneSettings

from .batching import scene_batch
from .config import TrainConfig
from .losses import scene_losses
from .scenes import TrainingEntry

BANDS = {"low": (0.0, LOW_LEVEL), "middle": (LOW_LEVEL, 0.3), "high": (0.3, 1.0)}
"""Noise levels s of each band: millimetres, centimetres, anywhere."""
PROCEDURAL = "procedural"
"""All procedural grippers count as one."""


@dataclasses.dataclass(frozen=True)
class ValidationResult:
    """Losses on held-out objects.

    Attributes:
        losses: diffusion, score, confidence, graspability: means over the grippers.
        per_gripper: diffusion loss of every gripper, procedural ones together.
        per_band: diffusion loss of every band of `BANDS`, mean over the grippers.
    """

    losses: dict[str, float]
    per_gripper: dict[str, float]
    per_band: dict[str, float]


def validation_pairs(
    entries: Sequence[TrainingEntry], config: TrainConfig
) -> tuple[tuple[str, str], ...]:
    """Key of the scene and gripper of every pair that validates: for each gripper up to
    `config.validation_pairs` scenes in which it has a positive, in an order by a hash of their
    names, so that every gripper is there and growing data changes little.
    """
    found: dict[str, list[tuple[int, str, str]]] = {}
    for entry in entries:
        for name in entry.positives():
            if name in config.grippers or is_procedural(name):
                kind = PROCEDURAL if is_procedural(name) else name
                order = zlib.crc32(f"{entry.key} {name}".encode())
                found.setdefault(kind, []).append((order, entry.key, name))
    return tuple(
        (scene, gripper)
        for kind in sorted(found)
        for _, scene, gripper in sorted(found[kind])[: config.validation_pairs]
    )


@torch.no_grad()
def validate(
    model: GraspModel,
    entries: Mapping[str, TrainingEntry],
    pairs: Sequence[tuple[str, str]],
    tokens: Mapping[str, GripperTokens],
    config: TrainConfig,
    settings: SceneSettings,
    schedule: NoiseSchedule,
    folds: Mapping[str, int],
) -> ValidationResult:
    """Losses of the model on pairs of scene and gripper.

    Args:
        model: with averaged weights.
        entries: by key.
        pairs: of `validation_pairs`; those whose scene is gone are left out.
        tokens: of every gripper of the pairs.
        config: of the run.
        settings: preprocessing.
        schedule: noise.
        folds: symmetry of every gripper.
    """
    # Levels are even over all of log s here, whatever training prefers: bands stay comparable.
    config = dataclasses.replace(config, train_only="all", low_levels=None)
    found: dict[str, dict[str, list[float]]] = {}
    bands: dict[str, dict[str, list[float]]] = {}
    for scene, gripper in pairs:
        entry = entries.get(scene)
        if entry is None or gripper not in entry.tables:
            continue
        seed = zlib.crc32(f"{scene} {gripper}".encode())
        nodes, graph = entry.nodes(settings, config.network)
        batch = scene_batch(
            nodes,
            graph,
            {gripper: entry.tables[gripper]},
            config,
            np.random.default_rng(seed),
            poses_per_gripper=config.validation_poses,
        )
        generator = torch.Generator(model.device).manual_seed(seed)
        codes = {gripper: model.encode_gripper(tokens[gripper])}
        losses = scene_losses(model, codes, batch, config, schedule, generator, folds)
        kind = PROCEDURAL if is_procedural(gripper) else gripper
        for name, value in losses.values.items():
            found.setdefault(kind, {}).setdefault(name, []).append(value)
        for band, (low, high) in BANDS.items():
            inside = (losses.level > low) & (losses.level <= high)
            if bool(inside.any()):
                value = float(losses.residual[inside].mean())
                bands.setdefault(band, {}).setdefault(kind, []).append(value)
    per_gripper = {kind: float(np.mean(values["diffusion"])) for kind, values in found.items()}
    names = dict.fromkeys(name for values in found.values() for name in values)
    return ValidationResult(
        {
            name: float(np.mean([np.mean(values[name]) for values in found.values()
                                 if name in values]))
            for name in names
        },
        per_gripper,
        {
            band: float(np.mean([np.mean(values) for values in kinds.values()]))
            for band, kinds in bands.items()
        },
    )  # fmt: skip

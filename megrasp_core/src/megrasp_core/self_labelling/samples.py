"""The model's own samples, tried in simulation: what its confidence has to tell apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from megrasp_core.diffusion import NoiseSchedule, SamplerSettings, last_step, sample_steps
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.jobs import versions
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.network import GraspModel
from megrasp_core.objects import ObjectSet
from megrasp_core.simulation import (
    START_DEPTH,
    Reason,
    World,
    approach_path,
    build_world,
    judge,
    start_depths,
)
from megrasp_core.storage import (
    NOT_TRIED,
    GripperLabels,
    Kind,
    SceneDataset,
    SceneRecord,
    SceneWriter,
)
from megrasp_core.synthesizer import denoiser, draw_starts


@dataclasses.dataclass(frozen=True)
class SampleSettings:
    """Amounts of `label_samples`.

    Attributes:
        samples: drawn per scene and gripper.
        judged: at most this many of those free of collision are tried in the heap; the others
            that are free are left out.
        colliding: at most this many of those that collide are kept, as failures.
        approach_distance: length (m) of the way to the pre-grasp that must be free in bins.
        max_depth: deepest penetration (m) that still counts as free.
        sampler: what the poses go through; None: what the model says.
        seed: of starts and noise.
    """

    samples: int = 48
    judged: int = 16
    colliding: int = 16
    approach_distance: float = 0.10
    max_depth: float = START_DEPTH
    sampler: SamplerSettings | None = None
    seed: int = 1


@torch.inference_mode()
def draw_poses(
    record: SceneRecord, model: GraspModel, gripper: Gripper, settings: SampleSettings
) -> np.ndarray:
    """Sample `(n, 4, 4)` world_from_tcp for a stored scene."""
    sampler = settings.sampler or model.info.sampler
    nodes = record.nodes(model.info.scene)
    field = model.encode_scene(nodes)
    code = model.encode_gripper(gripper.tokens(model.config.gripper_tokens, seed=0))
    schedule = NoiseSchedule.of(model.config)
    generator = torch.Generator(model.device).manual_seed(settings.seed * 1_000_003 + record.seed)
    starts = draw_starts(model, field, code, settings.samples, generator)
    steps = sample_steps(
        denoiser(model, field, code, sampler), starts, sampler, schedule, generator
    )
    last = last_step(steps).poses
    poses = np.tile(np.eye(4), (settings.samples, 1, 1))
    poses[:, :3, :3] = last.rotation.cpu().double().numpy()
    poses[:, :3, 3] = last.translation.cpu().double().numpy() + nodes.centroid
    return poses


def world_of(record: SceneRecord, gripper: Gripper, objects: ObjectSet) -> World:
    """A stored scene as it settled, with a gripper."""
    return build_world(
        [objects[name] for name in record.object_names],
        gripper=gripper,
        bin=record.bin,
        obstacles=set(np.flatnonzero(record.obstacle).tolist()),
        object_poses=matrix_from_pose7(record.object_poses.astype(np.float64)),
    )


def judge_poses(
    record: SceneRecord,
    gripper: Gripper,
    objects: ObjectSet,
    world_from_tcp: np.ndarray,
    settings: SampleSettings,
) -> GripperLabels:
    """Label poses by the verdict in the record's scene; in a bin with the approach path."""
    world = world_of(record, gripper, objects)
    # Objects at rest sleep until touched: half the time, the same verdicts.
    world.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    state = world.save()
    world_from_gripper: NDArray[np.float64] = np.asarray(
        world_from_tcp @ gripper.tcp_from_gripper, np.float64
    )
    start = start_depths(world, world_from_gripper)
    depth = start.copy()
    if world.bin is not None:
        for index in np.flatnonzero(depth <= settings.max_depth):
            back = world_from_gripper[index].copy()
            back[:3, 3] -= settings.approach_distance * back[:3, 2]
            path = approach_path(back, world_from_gripper[index], 10)
            depth[index] = max(depth[index], float(start_depths(world, path).max()))
    free = np.flatnonzero(depth <= settings.max_depth)[: settings.judged]
    hit = np.flatnonzero(depth > settings.max_depth)[: settings.colliding]
    centres = np.asarray(record.object_poses[:, :3], np.float64)
    rows: list[tuple[int, int, int, str, int]] = []
    for index in free:
        world.restore(state)
        verdict = judge(world, world_from_gripper[index])
        nearest = int(np.linalg.norm(centres - world_from_tcp[index, :3, 3], axis=1).argmin())
        owner = nearest if verdict.target is None else verdict.target
        reason = "" if verdict.success else verdict.reason.value
        rows.append((index, owner, int(verdict.success), reason, verdict.extra))
    for index in hit:
        nearest = int(np.linalg.norm(centres - world_from_tcp[index, :3, 3], axis=1).argmin())
        at_start = start[index] > settings.max_depth
        reason = Reason.START_COLLISION if at_start else Reason.APPROACH_COLLISION
        rows.append((index, nearest, 0, reason.value, NOT_TRIED))
    chosen = np.array([row[0] for row in rows], dtype=int)
    return GripperLabels.of(
        world_from_tcp[chosen],
        object=[row[1] for row in rows],
        label=[row[2] for row in rows],
        kind=Kind.SAMPLED,
        reason=[row[3] for row in rows],
        extra=[row[4] for row in rows],
    )


def label_samples(
    data: str | Path,
    out: str | Path,
    model: GraspModel,
    grippers: Iterable[str],
    objects: ObjectSet,
    settings: SampleSettings,
    *,
    indices: Iterable[int] | None = None,
    on_scene: Callable[[int, int, dict[str, tuple[int, int]]], None] | None = None,
) -> int:
    """Write copies of the scenes of a data set that hold the model's labelled samples; resumable.

    Args:
        data: data set folder.
        out: data set folder for the copies.
        model: whose samples; should be the one whose heads are trained with them.
        grippers: which grippers.
        objects: models by name.
        settings: amounts.
        indices: scenes of the data set; default all.
        on_scene: called with scenes done, scenes in all and per gripper (successes, labels).

    Returns:
        Number of scenes written.

    Raises:
        DataError: `out` holds samples of another model, gripper or settings.
    """
    dataset = SceneDataset(data)
    rack = [load_gripper(name) for name in grippers]
    writer = SceneWriter(
        Path(out),
        {
            "samples_of": model.model_id,
            "weights": model.info.sha256,
            "settings": dataclasses.asdict(settings),
            "grippers": {gripper.name: gripper.hash for gripper in rack},
            "versions": versions(),
        },
    )
    wanted = list(range(len(dataset)) if indices is None else indices)
    written = 0
    try:
        for done, index in enumerate(wanted):
            record = dataset[index]
            if record.seed in writer:
                continue
            labels = {}
            for gripper in rack:
                poses = draw_poses(record, model, gripper, settings)
                labels[gripper.name] = judge_poses(record, gripper, objects, poses, settings)
            writer.add(dataclasses.replace(record, labels=labels))
            written += 1
            if on_scene is not None:
                counts = {k: (int(v.label.sum()), len(v)) for k, v in labels.items()}
                on_scene(done + 1, len(wanted), counts)
    finally:
        writer.close()
    return written

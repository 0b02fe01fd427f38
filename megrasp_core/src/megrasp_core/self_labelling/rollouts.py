"""Bins and tables that the model itself clears: every stage becomes a scene with labels of its own
grasps.

What a confidence has to tell apart are the grasps that come out of the whole synthesis, in the
states that executing them leads to: half-empty bins, obstacles, what failed before.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from megrasp_core.cell.pick_cycle import PickCycle
from megrasp_core.errors import EmptyRegionError, InvalidRequestError, SimulationError
from megrasp_core.jobs import versions
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.objects import ObjectSet
from megrasp_core.pointcloud import Cloud, surface_cloud
from megrasp_core.scenes import (
    GRAVITY,
    SceneConfig,
    ViewShares,
    draw_layout,
    region_of,
    scene_cameras,
)
from megrasp_core.simulation import DepthNoise, Verdict, World, build_world
from megrasp_core.storage import (
    GripperLabels,
    Kind,
    SceneRecord,
    SceneWriter,
    pack_normals,
    scene_name,
)
from megrasp_core.synthesizer import GraspSynthesizer, RankedGrasp

LOGGER = logging.getLogger(__name__)

STAGES = 100
"""Seeds of the records of one scene: seed * STAGES + stage."""


IN_BINS = SceneConfig(
    grippers=(), objects=(2, 11), bin_share=1.0, bin_spread=0.05, obstacle_share=0.85
)
ON_TABLES = SceneConfig(
    grippers=(), objects=(2, 11), bin_share=0.0, obstacle_share=0.0, views=ViewShares(dense=0.6)
)


@dataclasses.dataclass(frozen=True)
class RolloutSettings:
    """Amounts.

    Attributes:
        judged: best ranked grasps tried at every stage.
        rejected: at most so many that fail the check are tried as well.
        max_stages: of a scene.
        max_failures: in a row, after which a scene is given up.
        drawn: poses of a synthesis.
        scenes: what they are like. In bins the approach must be free, on tables only the start.
    """

    judged: int = 10
    rejected: int = 6
    max_stages: int = 14
    max_failures: int = 3
    drawn: int = 100
    scenes: SceneConfig = IN_BINS


@dataclasses.dataclass(frozen=True)
class RolloutSummary:
    """What `label_rollouts` did: stages written, and scenes that failed."""

    stages: int
    failed: int


def roll_out(
    seed: int, synthesizer: GraspSynthesizer, objects: ObjectSet, settings: RolloutSettings
) -> list[SceneRecord]:
    """Clear one scene with the synthesizer's gripper and return a labelled record for every stage.

    Raises:
        SimulationError: the scene does not come to rest.
    """
    gripper = synthesizer.gripper
    assert gripper is not None
    config = settings.scenes
    layout = draw_layout(seed, config, objects)
    obstacles = set(np.flatnonzero(layout.obstacle).tolist())
    world = build_world(
        [objects[name] for name in layout.object_names],
        gripper=gripper,
        bin=layout.bin,
        obstacles=obstacles,
        object_poses=layout.matrices,
    )
    in_bin = layout.bin is not None
    cameras = scene_cameras(seed, config, in_bin=in_bin)
    rng = np.random.default_rng([seed, 4])
    region = region_of(layout.bin, config)
    cycle = PickCycle(world, obstacles)
    records: list[SceneRecord] = []
    while len(records) < settings.max_stages and cycle.failures.in_a_row < settings.max_failures:
        if not cycle.left:
            break
        present = sorted(world.present)
        cloud = cycle.look(cameras, DepthNoise(), rng)
        draw = int(rng.integers(2**31))
        grasps = cycle.failures.ask(
            lambda failed, cloud=cloud, draw=draw: (
                synthesizer.synthesize(
                    cloud,
                    num_grasps=settings.drawn,
                    drawn=settings.drawn,
                    region=region,
                    exclude=failed,
                    exclude_radius=0.05,
                    seed=draw,
                    keep_all=True,
                ).grasps
            ),
            lambda grasps: any(grasp.collision_free for grasp in grasps),
        )
        passing = [grasp for grasp in grasps if grasp.collision_free]
        # What was never refined comes out of no synthesis.
        others = [g for g in grasps if not g.collision_free and g.reason != "unrefined"]
        chosen = passing[: settings.judged]
        if others:
            picked = rng.permutation(len(others))[: settings.rejected]
            chosen = chosen + [others[i] for i in picked]
        verdicts = [cycle.verdict(grasp, approach=in_bin) for grasp in chosen]
        records.append(
            dataclasses.replace(
                _seen(seed * STAGES + len(records), layout.object_names, world, cloud, config),
                obstacle=np.array([place in obstacles for place in present]),
                bin=layout.bin,
                labels={gripper.name: _labels(chosen, verdicts, present, world)},
            )
        )
        if not passing:
            break
        cycle.execute(passing[0], approach=in_bin)
    return records


def label_rollouts(
    out: str | Path,
    synthesizer: GraspSynthesizer,
    objects: ObjectSet,
    seeds: Iterable[int],
    settings: RolloutSettings | None = None,
    *,
    on_scene: Callable[[int, int, int], None] | None = None,
) -> RolloutSummary:
    """Write the stages of many scenes as a data set; resumable scene by scene.

    Args:
        out: data set folder.
        synthesizer: model with a gripper.
        objects: what the scenes are filled from.
        seeds: one scene each.
        settings: amounts.
        on_scene: called with the seed, and successes and labels so far.

    Returns:
        What was done. Scenes that failed are told in the log; run it again to try them again.

    Raises:
        DataError: `out` holds rollouts of another model, gripper, settings or objects.
        InvalidRequestError: no gripper is set.
    """
    settings, gripper = settings or RolloutSettings(), synthesizer.gripper
    if gripper is None:
        raise InvalidRequestError("no gripper is set; expected one. Call set_gripper first.")
    facts = {
        "rollouts_of": synthesizer.model.model_id,
        "weights": synthesizer.model.info.sha256,
        "settings": dataclasses.asdict(settings),
        "objects": list(objects.names),
        "grippers": {gripper.name: gripper.hash},
        "versions": versions(),
    }
    writer = SceneWriter(Path(out), facts)
    stages = failed = won = tried = 0
    try:
        for seed in seeds:
            if seed * STAGES in writer:
                continue
            try:
                records = roll_out(seed, synthesizer, objects, settings)
            except (SimulationError, EmptyRegionError) as error:
                LOGGER.warning("scene %d was left out: %s", seed, error)
                records = []
                failed += 1
            # The first stage marks the scene as done, so it goes last.
            for record in reversed(records):
                writer.add(record)
                won += sum(int(part.label.sum()) for part in record.labels.values())
                tried += sum(len(part) for part in record.labels.values())
            stages += len(records)
            if on_scene is not None:
                on_scene(seed, won, tried)
    finally:
        writer.close()
    return RolloutSummary(stages, failed)


def _seen(
    number: int, names: tuple[str, ...], world: World, cloud: Cloud, config: SceneConfig
) -> SceneRecord:
    """What the camera saw of the objects that are still there, without labels."""
    present = sorted(world.present)
    region = region_of(world.bin, config)
    surface = surface_cloud(
        cloud, gravity=np.array(GRAVITY), region=region, settings=config.surface
    )
    return SceneRecord(
        name=scene_name(number),
        seed=number,
        object_names=tuple(names[place] for place in present),
        object_poses=pose7_from_matrix(world.object_poses()[present]).astype(np.float32),
        obstacle=np.zeros(len(present), bool),
        bin=None,
        points=surface.points.astype(np.float16),
        normals=pack_normals(surface.normals),
        on_plane=surface.on_plane,
        sensor=np.asarray(surface.sensor, np.float32),
        gravity=np.asarray(GRAVITY, np.float32),
    )


def _labels(
    grasps: list[RankedGrasp], verdicts: list[Verdict], present: list[int], world: World
) -> GripperLabels:
    poses = np.array([grasp.world_from_tcp for grasp in grasps]).reshape(-1, 4, 4)
    centres = world.object_poses()[present][:, :3, 3]
    nearest = np.linalg.norm(poses[:, None, :3, 3] - centres, axis=2).argmin(axis=1)
    owner = [
        near if verdict.target is None else present.index(verdict.target)
        for near, verdict in zip(nearest.tolist(), verdicts)
    ]
    return GripperLabels.of(
        poses,
        object=owner,
        label=[verdict.success for verdict in verdicts],
        kind=Kind.SAMPLED,
        reason=["" if v.success else v.reason.value for v in verdicts],
        extra=[verdict.extra for verdict in verdicts],
    )

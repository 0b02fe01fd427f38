"""Training scenes: from a seed to a labelled record, and runs of many seeds into a data set
folder.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.grippers import procedural_gripper_name, procedural_rack
from megrasp_core.jobs import ExecutorConfig, Progress, RunSummary, log_run, run_units, versions
from megrasp_core.library import GraspLibrary, cached_gripper, load_library
from megrasp_core.objects import ObjectSet
from megrasp_core.storage import SceneRecord, SceneWriter, pack_normals, scene_name

from .layout import GRAVITY, LABELS, SceneConfig, draw_layout, stream
from .observing import scene_surface
from .scene_labels import SceneLabeller


def build_scene(
    seed: int, config: SceneConfig, library: GraspLibrary, objects: ObjectSet
) -> SceneRecord:
    """Makes one scene: settles objects, looks from above, labels grasps for every gripper.

    The same seed, config, library and objects give the same record, bit for bit on one machine. On
    another processor the heap may come to rest otherwise, and a verdict may differ.

    Args:
        seed: of the scene.
        config: how scenes are drawn and labelled.
        library: free-space grasps of the objects for the config's grippers.
        objects: what is drawn from.

    Raises:
        SimulationError: the heap does not come to rest.
        EmptyRegionError: the camera saw nothing of the region.
    """
    layout = draw_layout(seed, config, objects)
    surface = scene_surface(layout, seed, config, objects)
    labels = {}
    for name in scene_grippers(seed, config, in_bin=layout.bin is not None):
        gripper = cached_gripper(name)
        labels[gripper.name] = SceneLabeller(
            layout, gripper, library, objects, seed, config
        ).labels()
    return SceneRecord(
        name=scene_name(seed),
        seed=seed,
        object_names=layout.object_names,
        object_poses=layout.object_poses,
        obstacle=layout.obstacle,
        bin=layout.bin,
        points=surface.points.astype(np.float16),
        normals=pack_normals(surface.normals),
        on_plane=surface.on_plane,
        sensor=np.asarray(surface.sensor, np.float32),
        gravity=np.asarray(GRAVITY, np.float32),
        labels=labels,
    )


def scene_grippers(seed: int, config: SceneConfig, *, in_bin: bool) -> list[str]:
    """Grippers that the scene of a seed is labelled for: those of the config in its order, then
    procedural ones.

    Raises:
        InvalidRequestError: more grippers a scene than there are.
    """
    rng = stream(seed, LABELS)
    count = len(config.grippers)
    wanted = count if config.grippers_per_scene is None else config.grippers_per_scene
    if not 1 <= wanted <= count:
        raise InvalidRequestError(
            f"grippers_per_scene is {wanted}; expected 1 to {count}, the number of grippers."
        )
    of_hands = config.hands_in_bins if in_bin else config.hands_on_tables
    weight = np.array(
        [
            of_hands if cached_gripper(name).description.kind == "hand" else 1.0
            for name in config.grippers
        ]
    )
    # Those with the first arrivals of Poisson processes with these rates: drawn without
    # replacement in proportion to the weights.
    arrival = rng.exponential(size=count) / np.maximum(weight, 1e-9)
    chosen = np.argsort(arrival)[:wanted]
    rack = min(config.procedural_per_scene, config.procedural_grippers)
    numbers = rng.permutation(config.procedural_grippers)[:rack]
    return [
        *(config.grippers[index] for index in sorted(chosen)),
        *(procedural_gripper_name(int(number)) for number in sorted(numbers)),
    ]


@dataclass(frozen=True)
class SceneJob:
    """What a worker needs to make scenes.

    Attributes:
        config: how scenes are drawn and labelled.
        library: packed file or folder of the grasp library; read once a process.
        objects: what is drawn from; objects without library grasps get fresh ones only.
    """

    config: SceneConfig
    library: Path
    objects: ObjectSet


@functools.lru_cache(maxsize=2)
def _library(path: Path) -> GraspLibrary:
    return load_library(path)


def _build(seed: int, job: SceneJob) -> SceneRecord:
    return build_scene(seed, job.config, _library(job.library), job.objects)


def manifest_of(job: SceneJob) -> dict[str, Any]:
    """What identifies a data set: config, objects, grippers with their hashes, and the versions it
    was made with.
    """
    return {
        "config": asdict(job.config),
        "objects": list(job.objects.names),
        "grippers": {
            cached_gripper(name).name: cached_gripper(name).hash
            for name in [*job.config.grippers, *procedural_rack(job.config.procedural_grippers)]
        },
        "library": job.library.name,
        "versions": versions(),
    }


def generate_scenes(
    folder: str | Path,
    job: SceneJob,
    seeds: Iterable[int],
    executor: ExecutorConfig | None = None,
    *,
    shard_size: int = 64,
    on_progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Makes the scenes of `seeds` that are missing in `folder`.

    Args:
        folder: data set folder; one made with the same job is continued.
        job: config, library, objects.
        seeds: one scene each.
        executor: where to run.
        shard_size: scenes a shard.
        on_progress: called after every scene.

    Returns:
        What was done; seeds whose heap did not come to rest are listed as failed.

    Raises:
        DataError: no objects, no library, `folder` holds another data set, or another run is
            writing to it.
        OSError: `folder` cannot be written.
    """
    job = SceneJob(job.config, Path(job.library), job.objects)
    if not len(job.objects):
        raise DataError(
            "the object set is empty; expected at least one object. Give procedural or asset "
            "objects."
        )
    # Here too, so that a damaged library is told once and not by every scene.
    _library(job.library)
    writer = SceneWriter(Path(folder), manifest_of(job), shard_size)
    try:
        summary = run_units(
            functools.partial(_build, job=job),
            [seed for seed in seeds if seed not in writer],
            executor,
            on_result=lambda seed, record: writer.add(record),
            on_progress=on_progress,
        )
        log_run(writer.folder, executor, summary)
        return summary
    finally:
        writer.close()

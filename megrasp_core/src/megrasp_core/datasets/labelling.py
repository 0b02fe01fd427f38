"""Labels grasp candidates of single objects in the free-space trial and fills a library folder
(DESIGN section 5).
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from megrasp_core.datasets.candidates import CandidateSettings, ObjectSurface, antipodal
from megrasp_core.datasets.executors import ExecutorConfig, Progress, RunSummary, run_units
from megrasp_core.datasets.library import pair_file, thinned, write_grasp_set
from megrasp_core.datasets.object_set import ObjectSet
from megrasp_core.datasets.records import GraspSet
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.lie.pose import pose7_from_matrix
from megrasp_core.objects import ObjectModel
from megrasp_core.simulation import FreeSpaceRig

START_COLLISION = "start_collision"


@dataclass(frozen=True)
class LabelSettings:
    """How much work a (gripper, object) pair gets.

    Attributes:
        count: candidates drawn at most, start collisions included.
        trials: full trials at most.
        target: successes after which the pair is done.
        failures: failed full trials kept for each success kept; at least four are kept where there
            are any.
        hopeless: full trials without any success after which the pair is given up.
        candidates: how candidates are drawn.
    """

    count: int = 240
    trials: int = 60
    target: int = 40
    failures: float = 0.5
    hopeless: int = 24
    candidates: CandidateSettings = field(default_factory=CandidateSettings)


def label_object(
    gripper: Gripper,
    model: ObjectModel,
    count: int,
    seed: int,
    *,
    settings: LabelSettings | None = None,
    object_name: str | None = None,
) -> GraspSet:
    """Tries antipodal candidates on one free-floating object.

    Args:
        gripper: closes with its description's force limits.
        model: the object.
        count: candidates drawn at most.
        seed: with the names of gripper and object it fixes the candidates.
        settings: when to stop and what to keep (`count` here is not used).
        object_name: name in the object set; default the model's own.

    Returns:
        All successes and a share of the full trials that failed, as `object_from_tcp`.
    """
    settings = settings or LabelSettings()
    name = object_name or model.name
    rng = np.random.default_rng(
        [seed, zlib.crc32(gripper.name.encode()), zlib.crc32(name.encode())]
    )
    candidates = antipodal(
        model, gripper, count, rng, settings=settings.candidates, surface=ObjectSurface(model)
    )
    rig = FreeSpaceRig(gripper, model)
    kept: list[int] = []
    success: list[bool] = []
    reasons: list[str] = []
    drawn = 0
    for index, pose in enumerate(candidates.object_from_gripper):
        drawn = index + 1
        result = rig.trial(pose)
        reason = str(getattr(result.reason, "value", result.reason))
        if not result.success and reason == START_COLLISION:
            continue
        kept.append(index)
        success.append(bool(result.success))
        reasons.append("" if result.success else reason)
        held = sum(success)
        if held >= settings.target or len(kept) >= settings.trials:
            break
        if held == 0 and len(kept) >= settings.hopeless:
            break
    poses = candidates.object_from_gripper[kept].reshape(-1, 4, 4) @ gripper.gripper_from_tcp
    entry = GraspSet(
        gripper=gripper.name,
        gripper_hash=gripper.hash,
        object_name=name,
        object_from_tcp=np.asarray(pose7_from_matrix(poses), np.float64).reshape(-1, 7),
        success=np.array(success, bool),
        reason=np.array(reasons, np.str_),
        drawn=drawn,
        tried=len(kept),
    )
    return thinned(entry, max(4, round(settings.failures * int(entry.success.sum()))))


@dataclass(frozen=True)
class LibraryConfig:
    """A library to make.

    Attributes:
        grippers: names or folders.
        objects: the object set.
        seed: base seed.
        settings: work a pair.
    """

    grippers: tuple[str, ...]
    objects: ObjectSet
    seed: int = 0
    settings: LabelSettings = field(default_factory=LabelSettings)


@functools.lru_cache(maxsize=16)
def cached_gripper(name: str) -> Gripper:
    """The gripper of a name, loaded once a process."""
    return load_gripper(name)


def _label_pair(unit: tuple[str, str], config: LibraryConfig) -> GraspSet:
    gripper = cached_gripper(unit[0])
    return label_object(
        gripper,
        config.objects[unit[1]],
        config.settings.count,
        config.seed,
        settings=config.settings,
        object_name=unit[1],
    )


def generate_library(
    folder: str | Path,
    config: LibraryConfig,
    executor: ExecutorConfig | None = None,
    *,
    names: Sequence[str] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Labels every pair whose file is missing in `folder`, all grippers of an object before the
    next object.

    Args:
        folder: library folder; an existing one is continued.
        config: grippers, objects, seed, effort.
        executor: where to run.
        names: the objects to label, in this order; default all of the set, shuffled by the seed,
            so that any part of the work is a fair sample of the objects.
        on_progress: called after every pair.
    """
    folder = Path(folder)
    if names is None:
        order = np.random.default_rng(config.seed).permutation(len(config.objects.names))
        names = [config.objects.names[index] for index in order]
    gripper_names = {gripper: cached_gripper(gripper).name for gripper in config.grippers}
    units = [
        (gripper, name)
        for name in names
        for gripper in config.grippers
        if not pair_file(folder, gripper_names[gripper], name).exists()
    ]

    def keep(_: tuple[str, str], entry: GraspSet) -> None:
        write_grasp_set(folder, entry)

    return run_units(
        functools.partial(_label_pair, config=config),
        units,
        executor,
        on_result=keep,
        on_progress=on_progress,
    )

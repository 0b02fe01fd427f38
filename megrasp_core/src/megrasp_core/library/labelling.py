"""Labels grasp candidates of single objects in the free-space trial and fills a library folder
(docs/architecture.md, "Data").
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.jobs import ExecutorConfig, Progress, RunSummary, log_run, run_units
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.objects import ObjectModel, ObjectSet
from megrasp_core.simulation import FreeSpaceResult, FreeSpaceRig, Reason
from megrasp_core.storage import GraspSet, remove_leftovers

from .candidates import CandidateSettings, ObjectSurface, antipodal
from .grasp_library import find_pair, with_few_failures, write_grasp_set

STEP = 1.15
"""Factor by which moves grow or shrink."""

SCALES = (0.2, 4.0)
"""Smallest and largest moves as a multiple of the first. With less room, what holds almost
anywhere fails too seldom, and successes are what takes time.
"""


@dataclass(frozen=True)
class LabelSettings:
    """How much work a (gripper, object) pair gets.

    First candidates are tried, until a share `fresh` of the successes is found; then successes
    moved a little, where success ends, until there are enough successes and failures.

    Attributes:
        count: candidates drawn at most, start collisions included.
        moved: successes moved a little at most, start collisions included.
        trials: full trials at most.
        target: successes after which the pair is done.
        fresh: share of them that comes from candidates.
        failures: failed full trials wanted, as a share of `target`; so many are kept, at least
            four.
        hopeless: full trials without any success after which the pair is given up.
        move: standard deviation of the first moves along each axis (m).
        turn: of the first turns about each axis (rad).
        candidates: how candidates are drawn.
    """

    count: int = 1200
    moved: int = 12_000
    trials: int = 1200
    target: int = 100
    fresh: float = 0.6
    failures: float = 1.0
    hopeless: int = 40
    move: float = 0.010
    turn: float = np.deg2rad(15.0)
    candidates: CandidateSettings = field(default_factory=CandidateSettings)

    def is_over(self, held: int, tried: int, drawn: int) -> bool:
        """Whether there is enough of everything, or no use in going on, after `drawn` grasps,
        `tried` full trials and `held` successes.
        """
        enough = held >= self.target and tried - held >= round(self.failures * self.target)
        hopeless = not held and tried >= self.hopeless
        spent = tried >= self.trials or drawn >= self.count + self.moved
        return enough or hopeless or spent


def label_object(
    gripper: Gripper,
    model: ObjectModel,
    seed: int,
    *,
    settings: LabelSettings | None = None,
    object_name: str | None = None,
) -> GraspSet:
    """Tries grasps of one free-floating object.

    Args:
        gripper: closes with its description's force limits.
        model: the object.
        seed: with the names of gripper and object it fixes the grasps that are tried.
        settings: when to stop and what to keep.
        object_name: name in the object set; default the model's own.

    Returns:
        The successes and as many of the full trials that failed as `settings` ask for, as
        `object_from_tcp`, in the order in which they were tried.
    """
    settings = settings or LabelSettings()
    name = object_name or model.name
    rng = np.random.default_rng(
        [seed, zlib.crc32(gripper.name.encode()), zlib.crc32(name.encode())]
    )
    trials = _Trials(FreeSpaceRig(gripper, model), settings)
    candidates = antipodal(
        model,
        gripper,
        settings.count,
        rng,
        settings=settings.candidates,
        surface=ObjectSurface(model),
    ).object_from_gripper
    for pose in candidates:
        if trials.is_over or trials.held >= max(1, round(settings.fresh * settings.target)):
            break
        trials.attempt(pose)
    scale = 1.0
    while trials.held and not trials.is_over:
        near = trials.held_poses[int(rng.integers(trials.held))]
        moved = gripper.gripper_from_tcp @ _move(settings, scale, rng) @ gripper.tcp_from_gripper
        result = trials.attempt(near @ moved)
        # What always holds is moved further, until about one grasp in three does.
        if result.reason is not Reason.START_COLLISION:
            scale = np.clip(scale * (STEP**2 if result.success else 1.0 / STEP), *SCALES)
    poses = np.array(trials.poses).reshape(-1, 4, 4) @ gripper.gripper_from_tcp
    entry = GraspSet(
        gripper=gripper.name,
        gripper_hash=gripper.hash,
        object_name=name,
        object_from_tcp=np.asarray(pose7_from_matrix(poses), np.float64).reshape(-1, 7),
        success=np.array([result.success for result in trials.results], bool),
        quality=np.array([result.quality for result in trials.results], np.float32),
        reason=np.array(
            ["" if result.success else result.reason.value for result in trials.results], np.str_
        ),
        drawn=trials.drawn,
        tried=len(trials.results),
    )
    return with_few_failures(entry, max(4, round(settings.failures * settings.target)))


class _Trials:
    """What was tried of a pair.

    Attributes:
        poses: (4, 4) `object_from_gripper` of every full trial.
        results: their outcomes.
        drawn: grasps attempted, those that collide at the start too.
    """

    def __init__(self, rig: FreeSpaceRig, settings: LabelSettings) -> None:
        self._rig, self._settings = rig, settings
        self.poses: list[NDArray[np.float64]] = []
        self.results: list[FreeSpaceResult] = []
        self.held_poses: list[NDArray[np.float64]] = []
        self.drawn = 0

    @property
    def held(self) -> int:
        """Successes."""
        return len(self.held_poses)

    @property
    def is_over(self) -> bool:
        """Whether the pair got its work."""
        return self._settings.is_over(self.held, len(self.results), self.drawn)

    def attempt(self, pose: NDArray[np.float64]) -> FreeSpaceResult:
        """Try a pre-grasp (4, 4) and keep it, unless it collides at the start."""
        self.drawn += 1
        result = self._rig.trial(pose)
        if result.reason is Reason.START_COLLISION:
            return result
        self.poses.append(pose)
        self.results.append(result)
        if result.success:
            self.held_poses.append(pose)
        return result


def _move(settings: LabelSettings, scale: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A random pose (4, 4) around the identity."""
    out = np.eye(4)
    out[:3, 3] = rng.normal(scale=scale * settings.move, size=3)
    turn = rng.normal(scale=scale * settings.turn, size=3)
    out[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return out


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


@functools.lru_cache(maxsize=256)
def cached_gripper(name: str) -> Gripper:
    """The gripper of a name, loaded once a process."""
    return load_gripper(name)


def _label_pair(unit: tuple[str, str], config: LibraryConfig) -> GraspSet:
    gripper = cached_gripper(unit[0])
    return label_object(
        gripper,
        config.objects[unit[1]],
        config.seed,
        settings=config.settings,
        object_name=unit[1],
    )


def _is_finished(entry: GraspSet | None, settings: LabelSettings) -> bool:
    if entry is None:
        return False
    held = int(entry.success.sum())
    # Without any success the candidates were all there was to try.
    return not held or settings.is_over(held, entry.tried, entry.drawn)


def generate_library(
    folder: str | Path,
    config: LibraryConfig,
    executor: ExecutorConfig | None = None,
    *,
    names: Sequence[str] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> RunSummary:
    """Labels every pair whose file is missing or damaged in `folder`, or got less work than the
    settings want, all grippers of an object before the next object.

    Args:
        folder: library folder; an existing one is continued.
        config: grippers, objects, seed, effort.
        executor: where to run.
        names: the objects to label, in this order; default all of the set, shuffled by the seed,
            so that any part of the work is a fair sample of the objects.
        on_progress: called after every pair.
    """
    folder = Path(folder)
    # Runs for other grippers may be at work in the same folder; none takes this long to write.
    remove_leftovers(folder, age=3600.0)
    if names is None:
        order = np.random.default_rng(config.seed).permutation(len(config.objects.names))
        names = [config.objects.names[index] for index in order]
    gripper_names = {gripper: cached_gripper(gripper).name for gripper in config.grippers}
    units = [
        (gripper, name)
        for name in names
        for gripper in config.grippers
        if not _is_finished(find_pair(folder, gripper_names[gripper], name), config.settings)
    ]

    def keep(_: tuple[str, str], entry: GraspSet) -> None:
        write_grasp_set(folder, entry)

    summary = run_units(
        functools.partial(_label_pair, config=config),
        units,
        executor,
        on_result=keep,
        on_progress=on_progress,
    )
    made_with = {
        "seed": config.seed,
        "settings": asdict(config.settings),
        "grippers": sorted(gripper_names.values()),
        "objects": len(config.objects.names),
    }
    log_run(folder, executor, summary, made_with)
    return summary

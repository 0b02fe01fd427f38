"""Runs of robust labels (robust.py) over data sets, into a data set folder of the same
scenes.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.jobs import ExecutorConfig, Progress, RunSummary, log_run, run_units, versions
from megrasp_core.library import cached_gripper
from megrasp_core.objects import ObjectSet
from megrasp_core.storage import SceneDataset, SceneRecord, SceneWriter

from .robust import RobustSettings, RobustTrials, robust_count, robust_labels

_Results = dict[str, RobustTrials]


@dataclass(frozen=True, eq=False)
class _Unit:
    """A scene without its cloud, which no trial needs and no worker need be sent.

    Attributes:
        index: in the data set.
        record: the scene.
    """

    index: int
    record: SceneRecord

    def __str__(self) -> str:
        return self.record.name


def generate_robust(
    data: str | Path | Iterable[str | Path],
    out: str | Path,
    settings: RobustSettings | None = None,
    executor: ExecutorConfig | None = None,
    *,
    grasps: int | None = None,
    seed: int = 0,
    objects: ObjectSet | None = None,
    shard_size: int = 64,
    on_read: Callable[[int, int], object] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[RunSummary, int]:
    """Writes copies of the scenes of data sets that hold robust labels and no others; continues
    what is there.

    Args:
        data: data set folders; no scene may be in two of them.
        out: data set folder for the copies.
        settings: amounts and ranges.
        executor: where to run; a scene is a unit.
        grasps: scenes are taken in an order drawn from the seed until they have so many grasps;
            all without it. A run with more of them continues one with less.
        seed: of the order and of all draws.
        objects: models by name.
        shard_size: scenes a shard.
        on_read: called with scenes looked through and scenes in all, before the first trial.
        on_progress: called after every scene.

    Returns:
        What was done, and how many grasps got labels.

    Raises:
        DataError: a folder holds no data set, two hold the same scene, `out` is one of them or
            holds other data, or another run is writing to it.
        InvalidRequestError: no grasps, or a negative seed.
        OSError: `out` cannot be written.
    """
    settings, objects = settings or RobustSettings(), objects or ObjectSet(())
    if grasps is not None and grasps < 1:
        raise InvalidRequestError(f"grasps is {grasps}; expected at least 1.")
    if seed < 0:
        raise InvalidRequestError(f"seed is {seed}; expected 0 or more.")
    dataset = SceneDataset(data)
    if Path(out).resolve() in {folder.resolve() for folder in dataset.folders}:
        raise DataError(f"{out} is what is read; expected another folder. Give another --out.")
    _refuse_twins(dataset)
    writer = SceneWriter(Path(out), _manifest(settings, seed), shard_size)
    labelled = 0
    took: dict[str, _Took] = {}

    def add(unit: _Unit, results: _Results) -> None:
        nonlocal labelled
        labels = {name: result.labels for name, result in results.items() if len(result.labels)}
        writer.add(replace(dataset[unit.index], labels=labels))
        labelled += sum(map(len, labels.values()))
        for name in labels:
            took.setdefault(name, _Took()).add(results[name])

    try:
        units = _units(dataset, settings, seed, grasps, on_read)
        summary = run_units(
            functools.partial(_tried, objects=objects, settings=settings, seed=seed),
            [unit for unit in units if unit.record.seed not in writer],
            executor,
            on_result=add,
            on_progress=on_progress,
        )
        told = {name: one.told() for name, one in sorted(took.items())}
        log_run(writer.folder, executor, summary, {"grasps": labelled, "robust": told})
        return summary, labelled
    finally:
        writer.close()


def _tried(unit: _Unit, objects: ObjectSet, settings: RobustSettings, seed: int) -> _Results:
    return {
        name: robust_labels(unit.record, cached_gripper(name), objects, settings, seed)
        for name in unit.record.labels
    }


def _units(
    dataset: SceneDataset,
    settings: RobustSettings,
    seed: int,
    grasps: int | None,
    on_read: Callable[[int, int], object] | None,
) -> list[_Unit]:
    """The scenes that have anything to try, in the order of the seed, as many as it takes."""
    names = dataset.names
    # Each scene draws its place by itself, so that one more scene moves no other.
    order = sorted(
        range(len(names)), key=lambda index: sha256(f"{seed}/{names[index]}".encode()).digest()
    )
    units: list[_Unit] = []
    planned = 0
    for done, index in enumerate(order):
        if grasps is not None and planned >= grasps:
            break
        record = _without_cloud(dataset[index])
        count = robust_count(record, settings, seed)
        if count:
            units.append(_Unit(index, record))
        planned += count
        if on_read is not None:
            on_read(done + 1, len(order))
    return units


def _without_cloud(record: SceneRecord) -> SceneRecord:
    return replace(
        record, points=record.points[:0], normals=record.normals[:0], on_plane=record.on_plane[:0]
    )


def _refuse_twins(dataset: SceneDataset) -> None:
    twins = [name for name, count in Counter(dataset.names).items() if count > 1]
    if twins:
        raise DataError(
            f"{len(twins)} scenes, {twins[0]} among them, are in two of the folders; expected "
            "every scene once. Give folders whose scenes have other seeds."
        )


def _manifest(settings: RobustSettings, seed: int) -> dict[str, Any]:
    """What identifies the labels. Not the folders: more may be added, as more scenes may."""
    return {"robust": asdict(settings), "seed": seed, "versions": versions()}


class _Took:
    """What the grasps of one gripper took, for the log of runs."""

    def __init__(self) -> None:
        self._grasps = self._trials = 0
        self._cpu_seconds = 0.0
        self._failed: Counter[str] = Counter()

    def add(self, result: RobustTrials) -> None:
        self._grasps += len(result.labels)
        self._trials += result.trials
        self._cpu_seconds += result.cpu_seconds
        self._failed.update(result.failed)

    def told(self) -> dict[str, Any]:
        return {
            "grasps": self._grasps,
            "trials": self._trials,
            "cpu_seconds": round(self._cpu_seconds, 2),
            "failed": dict(self._failed.most_common()),
        }

"""Runs a protocol over many scenes and writes its result file."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from megrasp_core.errors import SimulationError
from megrasp_core.grippers import Gripper
from megrasp_core.jobs import ExecutorConfig, Progress, run_units
from megrasp_core.machine import processor
from megrasp_core.objects import ObjectModel

from .failure_pictures import FailurePictures
from .kept_scenes import KeptScenes
from .outcome import SceneOutcome
from .planners import Planner
from .protocols import ProtocolSettings, run_scene
from .search import GraspSearch
from .statistics import cluster_bootstrap, roc_auc, wilson


@dataclass(frozen=True)
class EvaluationResult:
    """Outcomes of all scenes and what was run."""

    settings: ProtocolSettings
    gripper: str
    executed_with: str
    model: str
    pool: int
    graspable: int
    objects: str
    scenes: tuple[SceneOutcome, ...]
    executor: ExecutorConfig | None = None

    def to_json(self) -> dict[str, Any]:
        """Content of the result file."""
        scenes, settings = self.scenes, self.settings
        sampled = [s.sampled for s in scenes]
        passed = [[x for x in part if x[1]] for part in sampled]
        attempts = [ok for s in scenes for ok, _ in s.first]
        counted = [x for s in scenes for x in s.first[: s.counted]]
        total = sum(len(part) for part in sampled)
        stages = sum(s.stages for s in scenes)
        seconds = np.array([t for s in scenes for t in s.seconds] or [0.0])
        content: dict[str, Any] = {
            "protocol": settings.protocol,
            "gripper": self.gripper,
            "executed_with": self.executed_with,
            "model": self.model,
            "seed": settings.seed,
            "scenes": len(scenes),
            "drawn": settings.drawn,
            "returned": settings.returned,
            "evaluations": max((s.evaluations for s in scenes), default=0),
            "first": wilson(sum(ok for ok, _ in counted), len(counted)).to_json(),
            "answered_share": round(sum(s.answered for s in scenes) / max(1, stages), 4),
            "seconds": {
                "median": round(float(np.median(seconds)), 4),
                "p95": round(float(np.quantile(seconds, 0.95)), 4),
            },
            "reasons": dict(Counter(reason for _, reason in counted)),
        }
        if total:
            won = [sum(x[0] for x in part) for part in sampled]
            good = [sum(x[0] for x in part) for part in passed]
            content["unfiltered"] = cluster_bootstrap(won, [len(p) for p in sampled]).to_json()
            content["filtered"] = cluster_bootstrap(good, [len(p) for p in passed]).to_json()
            content["kept_share"] = round(sum(len(p) for p in passed) / total, 4)
            content["sample_reasons"] = dict(Counter(x[2] for part in sampled for x in part))
            content["filtered_reasons"] = dict(Counter(x[2] for part in passed for x in part))
        if settings.protocol == "binpick":
            content["first_all"] = wilson(sum(attempts), len(attempts)).to_json()
            content |= _cleared(scenes, settings.possible_only)
        content["attempts"] = [
            {"counted": len(s.first[: s.counted]), "objects": s.objects}
            | {"of": [f"{reason}: {t}" for (_, reason), t in zip(s.first, s.targets, strict=True)]}
            for s in scenes
        ]
        content |= _judged(scenes)
        content["hardware"] = hardware()
        content["config"] = {
            **dataclasses.asdict(settings),
            "objects": self.objects,
            "pool": self.pool,
            "graspable_objects": self.graspable,
            "executor": "local" if self.executor is None else self.executor.kind,
            "workers": 1 if self.executor is None else self.executor.workers,
        }
        return content

    def write(self, path: str | Path) -> None:
        """Write the result file; missing folders are made."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.to_json(), indent=1) + "\n")


def _judged(scenes: Sequence[SceneOutcome]) -> dict[str, Any]:
    """What became of the returned grasps that were judged, one by one and stage by stage; nothing
    where none were.
    """
    stages = [stage for s in scenes for stage in s.judged if stage]
    grasps = [grasp for stage in stages for grasp in stage]
    if not grasps:
        return {}
    held = np.array([grasp.success for grasp in grasps])
    any_held = sum(any(grasp.success for grasp in stage) for stage in stages)
    objects = [{p for g in stage if g.success for p in g.lifted} for stage in stages]
    return {
        "judged": wilson(int(held.sum()), len(held)).to_json(),
        "score_auc": roc_auc(np.array([grasp.score for grasp in grasps]), held),
        "judged_stages": {
            "first": wilson(sum(stage[0].success for stage in stages), len(stages)).to_json(),
            "any": wilson(any_held, len(stages)).to_json(),
            "objects_lifted": round(float(np.mean([len(found) for found in objects])), 2),
        },
    }


def _cleared(scenes: Sequence[SceneOutcome], possible_only: bool) -> dict[str, Any]:
    """How far bins were cleared: of what can be lifted, and of all."""
    objects = sum(s.objects for s in scenes)
    removed = sum(s.removed for s in scenes)
    of_all = round(removed / max(1, objects), 4)
    if not possible_only:
        attempts = sum(len(s.first) for s in scenes)
        return {
            "cleared_of_all": of_all,
            "picks_per_object": round(attempts / max(1, removed), 3),
        }
    unreachable = sum(s.unreachable or 0 for s in scenes)
    counted = sum(s.removed if s.counted is None else s.removed_counted for s in scenes)
    attempts = sum(len(s.first[: s.counted]) for s in scenes)
    return {
        "cleared": round(counted / max(1, objects - unreachable), 4),
        "cleared_of_all": of_all,
        "unreachable": unreachable,
        "picks_per_object": round(attempts / max(1, counted), 3),
    }


def evaluate(
    settings: ProtocolSettings,
    gripper: Gripper,
    planner: Planner,
    pool: Sequence[ObjectModel],
    graspable: Sequence[int],
    *,
    objects: str = "procedural",
    planned_for: str | None = None,
    executor: ExecutorConfig | None = None,
    kept: KeptScenes | None = None,
    pictures: FailurePictures | None = None,
    on_scene: Callable[[int, EvaluationResult], None] | None = None,
) -> EvaluationResult:
    """Run all scenes of a protocol; where and by how many workers changes nothing but the time
    that they take.

    Args:
        settings: the run.
        gripper: in the simulation.
        planner: answers with grasps for that gripper, or for another description of it.
        pool: objects to draw from.
        graspable: indices of those that the gripper can hold.
        objects: where they come from, for the result file.
        planned_for: name of the gripper that the planner plans for, where it is another.
        executor: how the scenes are spread; by default one after another, in this process.
        kept: scenes of the same run that are done, and where further ones are kept.
        pictures: of the executed grasps that fail and count.
        on_scene: called with the number of scenes done and the result so far.

    Raises:
        SimulationError: a scene could not be run.
        KeyboardInterrupt: the run was stopped; rates of some scenes are not those of all.
    """
    search = GraspSearch(gripper) if settings.possible_only else None
    run = functools.partial(
        run_scene, settings, gripper, planner, pool, graspable, search=search, pictures=pictures
    )

    def result(outcomes: Mapping[int, SceneOutcome]) -> EvaluationResult:
        return EvaluationResult(
            settings,
            planned_for or gripper.name,
            gripper.name,
            planner.name,
            len(pool),
            len(graspable),
            objects,
            tuple(outcomes.values()),
            executor,
        )

    def tell(outcomes: Mapping[int, SceneOutcome], _: SceneOutcome) -> None:
        if on_scene is not None:
            on_scene(len(outcomes), result(outcomes))

    return result(run_scenes(run, settings.scenes, executor, tell, kept))


def run_scenes(
    run: Callable[[int], SceneOutcome],
    count: int,
    executor: ExecutorConfig | None,
    on_scene: Callable[[Mapping[int, SceneOutcome], SceneOutcome], None],
    kept: KeptScenes | None = None,
) -> dict[int, SceneOutcome]:
    """The outcomes of scenes by number, in order.

    Args:
        run: one scene by its number; picklable where the executor has several processes.
        count: of scenes.
        executor: how they are spread; None: one after another, in this process.
        on_scene: called with all outcomes so far, in order, and the latest.
        kept: scenes that are done, and where further ones are kept.

    Raises:
        SimulationError: a scene could not be run.
        KeyboardInterrupt: the run was stopped; rates of some scenes are not those of all.
    """
    outcomes = {} if kept is None else {i: o for i, o in kept.outcomes.items() if i < count}
    todo = [index for index in range(count) if index not in outcomes]

    def take(index: int, outcome: SceneOutcome) -> None:
        outcomes[index] = outcome
        if kept is not None:
            kept.add(index, outcome)
        on_scene(dict(sorted(outcomes.items())), outcome)

    if executor is None:
        for index in todo:
            take(index, run(index))
        return dict(sorted(outcomes.items()))
    summary = run_units(
        run,
        todo,
        executor,
        on_result=take,
        on_progress=_go_on_without_failures,
    )
    if summary.cancelled:
        raise KeyboardInterrupt
    return dict(sorted(outcomes.items()))


def _go_on_without_failures(progress: Progress) -> None:
    if progress.failed:
        raise SimulationError(
            f"a scene failed after {progress.done} of {progress.total}, as said before; expected "
            "all to run, since rates of some are not those of all. Run it with --executor local "
            "to see where."
        )


def hardware() -> dict[str, Any]:
    """Processor, cores and threads, for result files."""
    found = {**processor(), "threads": torch.get_num_threads()}
    if torch.cuda.is_available():
        found["gpu"] = torch.cuda.get_device_name()
    return found

"""Many rounds and their result file."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from megrasp_core.evaluation.planners import Planner
from megrasp_core.evaluation.report import hardware
from megrasp_core.evaluation.statistics import Rate, cluster_bootstrap, wilson
from megrasp_core.grippers import Gripper
from megrasp_core.objects import ObjectModel

from .protocol import ClutterSettings, OnAttempt, Round, Tried, run_round
from .world import Outcome

SURE = 0.9
"""Grasps with at least this score are counted apart."""


@dataclass(frozen=True)
class ClutterResult:
    """Outcomes of all rounds and what was run."""

    settings: ClutterSettings
    gripper: str
    executed_with: str
    model: str
    pool: int
    objects: str
    rounds: tuple[Round, ...]

    @property
    def attempts(self) -> list[Tried]:
        """Of all rounds."""
        return [tried for one in self.rounds for tried in one.tried]

    def grasp_success(self) -> Rate:
        """GSR: successes of all attempts."""
        tried = self.attempts
        return wilson(sum(t.attempt.success for t in tried), len(tried))

    def declutter(self) -> Rate:
        """DR: objects removed of all objects."""
        return cluster_bootstrap(
            [r.removed for r in self.rounds], [r.objects for r in self.rounds]
        )

    def to_json(self) -> dict[str, Any]:
        """Content of the result file."""
        settings = self.settings
        tried = self.attempts
        sure = [t.attempt.success for t in tried if t.grasp.score >= SURE]
        rest = [t.attempt.success for t in tried if t.grasp.score < SURE]
        causes = Counter(t.attempt.outcome for t in tried if not t.attempt.success)
        seconds = np.array([s for one in self.rounds for s in one.seconds] or [0.0])
        return {
            "protocol": settings.scene,
            "engine": settings.engine,
            "gripper": self.gripper,
            "executed_with": self.executed_with,
            "model": self.model,
            "seed": settings.seed,
            "rounds": len(self.rounds),
            "drawn": settings.drawn,
            "returned": settings.returned,
            "evaluations": max((r.evaluations for r in self.rounds), default=0),
            "gsr": self.grasp_success().to_json(),
            "dr": self.declutter().to_json(),
            "failures": {
                cause.value: causes[cause] for cause in Outcome if cause is not Outcome.SUCCESS
            },
            "endings": dict(Counter(one.ending for one in self.rounds)),
            "lost": sum(one.lost for one in self.rounds),
            f"score_from_{SURE}": wilson(sum(sure), len(sure)).to_json(),
            f"score_below_{SURE}": wilson(sum(rest), len(rest)).to_json(),
            "seconds": {
                "median": round(float(np.median(seconds)), 4),
                "p95": round(float(np.quantile(seconds, 0.95)), 4),
            },
            "hardware": hardware(),
            "config": {
                **dataclasses.asdict(settings),
                "object_set": self.objects,
                "pool": self.pool,
            },
            "attempts": [[_entry(t) for t in one.tried] for one in self.rounds],
        }


def _entry(tried: Tried) -> dict[str, Any]:
    grasp, attempt = tried.grasp, tried.attempt
    content: dict[str, Any] = {
        "outcome": attempt.outcome.value,
        "score": round(float(grasp.score), 3),
        "tilt": round(float(grasp.tilt), 3),
    }
    if attempt.success:
        content["removed"] = list(tried.removed)
    else:
        content["depth"] = round(attempt.depth, 5)
        content["tcp"] = [round(float(v), 4) for v in grasp.world_from_tcp[:3, 3]]
    return content


def evaluate_clutter(
    settings: ClutterSettings,
    gripper: Gripper,
    planner: Planner,
    pool: Sequence[ObjectModel],
    *,
    objects: str = "procedural",
    planned_for: str | None = None,
    on_round: Callable[[int, ClutterResult], None] | None = None,
    on_attempt: OnAttempt | None = None,
) -> ClutterResult:
    """Run all rounds.

    Args:
        settings: the run.
        gripper: in the simulation.
        planner: answers with grasps for that gripper.
        pool: objects to draw from.
        objects: where they come from, for the result file.
        planned_for: name of the gripper that the planner plans for, where it is another.
        on_round: called with the number of rounds done and the result so far.
        on_attempt: called after every attempt of the first round, for pictures.
    """
    rounds: list[Round] = []

    def result() -> ClutterResult:
        return ClutterResult(
            settings,
            planned_for or gripper.name,
            gripper.name,
            planner.name,
            len(pool),
            objects,
            tuple(rounds),
        )

    for index in range(settings.rounds):
        watch = on_attempt if index == 0 else None
        rounds.append(run_round(settings, gripper, planner, pool, index, watch))
        if on_round is not None:
            on_round(index + 1, result())
    return result()

"""Fits the score of a model to the verdict on its own grasps: in simulated bins of objects that it
was not trained on and that are not those of the final evaluation, or in a real cell (attempts.py).
"""

from __future__ import annotations

import functools
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError
from megrasp_core.grippers import Gripper
from megrasp_core.jobs import ExecutorConfig
from megrasp_core.objects import ObjectModel
from megrasp_core.ranking import (
    Calibration,
    fit_calibration,
    logistic_features,
)

from .kept_scenes import KeptScenes
from .outcome import SceneOutcome
from .planners import Planner
from .protocols import ProtocolSettings, run_scene
from .report import hardware, run_scenes
from .statistics import roc_auc

FOLDS = 5
ROWS = ("scene", "features", "confidence", "success")
"""What `JudgedGrasps` has of every grasp."""
LEAST_OF_A_KIND = 150
"""Fewer judged grasps of a kind of gripper are too few for a fit of their own."""


@dataclass(frozen=True)
class JudgedGrasps:
    """Grasps of one gripper with their verdicts, n rows.

    Attributes:
        gripper: name.
        kind: of gripper.
        scene: (n,) number of the bin or heap.
        features: (n, 4), see `logistic_features`.
        confidence: (n,) of the model.
        success: (n,) bool.
        first: successes and trials of the first grasps in the same bins.
    """

    gripper: str
    kind: str
    scene: np.ndarray
    features: np.ndarray
    confidence: np.ndarray
    success: np.ndarray
    first: tuple[int, int]

    def counts(self) -> dict[str, int]:
        """For the result file."""
        return {
            "scenes": len(np.unique(self.scene)),
            "judged": len(self.success),
            "successes": int(self.success.sum()),
            "first_successes": self.first[0],
            "first_trials": self.first[1],
        }


def judged_grasps(
    settings: ProtocolSettings,
    gripper: Gripper,
    planner: Planner,
    pool: Sequence[ObjectModel],
    graspable: Sequence[int],
    *,
    executor: ExecutorConfig | None = None,
    kept: KeptScenes | None = None,
    on_scene: Callable[[int, int, int], None] | None = None,
) -> JudgedGrasps:
    """Run a protocol and judge `settings.judged` grasps of every stage.

    Args:
        settings: of the protocol.
        gripper: in the simulation.
        planner: the model.
        pool: objects to draw from.
        graspable: indices of those that the gripper can hold.
        executor: how the scenes are spread; by default one after another, in this process.
        kept: scenes of the same run that are done, and where further ones are kept.
        on_scene: called with bins done, successes and trials of the first grasps so far.

    Raises:
        SimulationError: a scene could not be run.
        KeyboardInterrupt: the run was stopped.
    """

    def first_grasps(outcomes: Mapping[int, SceneOutcome]) -> tuple[int, int]:
        first = [success for outcome in outcomes.values() for success, _ in outcome.first]
        return sum(first), len(first)

    def tell(outcomes: Mapping[int, SceneOutcome], _: SceneOutcome) -> None:
        if on_scene is not None:
            on_scene(len(outcomes), *first_grasps(outcomes))

    run = functools.partial(run_scene, settings, gripper, planner, pool, graspable)
    outcomes = run_scenes(run, settings.scenes, executor, tell, kept)
    rows = [
        (index, grasp)
        for index, outcome in outcomes.items()
        for stage in outcome.judged
        for grasp in stage
    ]
    confidence = np.array([grasp.confidence for _, grasp in rows])
    return JudgedGrasps(
        gripper.name,
        gripper.description.kind,
        np.array([scene for scene, _ in rows], dtype=np.int64),
        logistic_features(
            confidence,
            np.array([grasp.tilt for _, grasp in rows]),
            np.array([grasp.hidden_share for _, grasp in rows]),
            np.array([grasp.clearance for _, grasp in rows]),
        ),
        confidence,
        np.array([grasp.success for _, grasp in rows], dtype=bool),
        first_grasps(outcomes),
    )


def write_judged(judged: Sequence[JudgedGrasps], path: Path) -> None:
    """Keep judged grasps for a later fit (npz); missing folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = {f.name: [getattr(part, f.name) for part in judged] for f in fields(JudgedGrasps)}
    content: dict[str, Any] = {
        name: np.concatenate(parts) if name in ROWS else np.array(parts)
        for name, parts in values.items()
    }
    np.savez_compressed(path, count=[len(part.success) for part in judged], **content)


def read_judged(path: Path) -> list[JudgedGrasps]:
    """The judged grasps of `write_judged`.

    Raises:
        DataError: the file is missing or holds something else.
    """
    try:
        with np.load(path) as file:
            ends = np.cumsum(file["count"])[:-1]
            content = {name: file[name] for name in ROWS}
            rows = {name: np.split(values, ends) for name, values in content.items()}
            return [
                JudgedGrasps(
                    gripper=str(gripper),
                    kind=str(kind),
                    first=(int(first[0]), int(first[1])),
                    **{name: parts[i] for name, parts in rows.items()},
                )
                for i, (gripper, kind, first) in enumerate(
                    zip(file["gripper"], file["kind"], file["first"], strict=True)
                )
            ]
    except (OSError, KeyError, IndexError, ValueError, zipfile.BadZipFile) as error:
        raise DataError(
            f"{path} cannot be read ({error}); expected the judged grasps that `megrasp "
            "calibrate` writes beside its result."
        ) from error


def calibrate(judged: Sequence[JudgedGrasps]) -> tuple[Calibration, dict[str, Any]]:
    """Fit to the grasps of all grippers, and report the quality on bins that were left out
    (5 folds; those whose remainder cannot be fitted, since all of it held or none, are not in it).

    Raises:
        InvalidRequestError: only successes or only failures were judged.
    """
    features = np.concatenate([part.features for part in judged])
    success = np.concatenate([part.success for part in judged])
    fold = np.concatenate([part.scene for part in judged]) % FOLDS
    final = fit_calibration(features, success)
    held_out = np.full(len(fold), np.nan)
    for k in np.unique(fold):
        mine = fold == k
        # Where the others all held, or none did, nothing can be fitted to them.
        if len(np.unique(success[~mine])) == 2:
            fit = fit_calibration(features[~mine], success[~mine])
            held_out[mine] = fit.of_features(features[mine])
    told = np.isfinite(held_out)
    held_out, outcome = held_out[told], success[told]
    confidence = np.concatenate([part.confidence for part in judged])
    return final, {
        "calibration": final.to_dict(),
        "grippers": _counts(judged),
        "confidence": quality(confidence, success),
        "held_out": {**quality(held_out, outcome), "judged": len(outcome)},
        "reliability": _reliability(held_out, outcome),
        "hardware": hardware(),
    }


def calibrate_kinds(
    judged: Sequence[JudgedGrasps],
) -> tuple[dict[str, Calibration], dict[str, Any]]:
    """Fit every kind of gripper by itself, where it has grasps enough.

    Returns:
        Kind -> fit, and kind -> report as of `calibrate`.
    """
    fitted: dict[str, Calibration] = {}
    reports: dict[str, Any] = {}
    for kind in sorted({part.kind for part in judged}):
        parts = [part for part in judged if part.kind == kind]
        successes = sum(int(part.success.sum()) for part in parts)
        grasps = sum(len(part.success) for part in parts)
        if grasps >= LEAST_OF_A_KIND and 0 < successes < grasps:
            fitted[kind], reports[kind] = calibrate(parts)
    return fitted, reports


def _counts(judged: Sequence[JudgedGrasps]) -> dict[str, dict[str, int]]:
    """Counts of each gripper, which several runs may have judged."""
    counts: dict[str, Counter[str]] = {}
    for part in judged:
        counts.setdefault(part.gripper, Counter()).update(part.counts())
    return {gripper: dict(of) for gripper, of in counts.items()}


def quality(probability: np.ndarray, success: np.ndarray) -> dict[str, float | None]:
    """Mean log loss (nats) and area under the ROC curve; None where there is nothing to tell."""
    if not len(success):
        return {"log_loss": None, "auc": None}
    p = np.clip(probability, 1e-4, 1 - 1e-4)
    loss = -np.where(success, np.log(p), np.log1p(-p)).mean()
    return {"log_loss": round(float(loss), 4), "auc": roc_auc(p, success)}


def _reliability(probability: np.ndarray, success: np.ndarray) -> list[dict[str, float]]:
    """Mean probability and observed rate per fifth of the range."""
    rows = []
    place = np.minimum((probability * 5).astype(int), 4)
    for k in np.unique(place):
        mine = place == k
        rows.append(
            {
                "predicted": round(float(probability[mine].mean()), 3),
                "observed": round(float(success[mine].mean()), 3),
                "count": int(mine.sum()),
            }
        )
    return rows

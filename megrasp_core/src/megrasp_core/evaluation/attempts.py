"""Attempts of a real cell as judged grasps, for the calibration of the score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from megrasp_core.errors import InvalidRequestError, MegraspError
from megrasp_core.grippers import load_gripper
from megrasp_core.network import GraspModel, ModelInfo
from megrasp_core.pointcloud import Cloud
from megrasp_core.ranking import Calibration, logistic_features
from megrasp_core.storage import Attempt
from megrasp_core.synthesizer import GraspSynthesizer

from .calibration import JudgedGrasps, quality

__all__ = [
    "LEAST",
    "LEAST_OF_EACH",
    "attempt_options",
    "judged_attempts",
    "recalibrated",
    "require_enough",
]

LEAST = 40
"""Attempts that a calibration needs; it has five weights, and a fifth is left out of each fit."""
LEAST_OF_EACH = 10
"""Successes and failures among them."""
SERIES = 5
"""So many attempts in a row are left out together: they are of nearly the same scene."""


def attempt_options(attempt: Attempt) -> dict[str, Any]:
    """Options of a synthesis request under which the attempt was made."""
    return {
        "gravity": attempt.gravity,
        "sensor": attempt.sensor,
        "region": attempt.region,
        "walls": attempt.walls,
        "floor": attempt.floor,
        "assume_empty": attempt.assume_empty,
    }


def judged_attempts(
    attempts: Iterable[Attempt], model: GraspModel, notes: list[str]
) -> tuple[list[JudgedGrasps], dict[str, dict[str, float | None]]]:
    """What the model and the check say of each attempt, with what became of it.

    Args:
        attempts: in the order of time; each is looked at once.
        model: whose score is to be calibrated; need not be the one that made the grasps.
        notes: gets a sentence for each attempt that is of no use.

    Returns:
        One part per gripper, and the quality of what was promised so far: `recorded`, the scores
        that the attempts were made with, and `before`, those of the model as it is calibrated now.

    Raises:
        InvalidRequestError: too few attempts, see `require_enough`.
    """
    synthesizer = GraspSynthesizer(model)
    rows: dict[str, list[tuple[int, np.ndarray, float, bool, float]]] = {}
    for index, attempt in enumerate(attempts):
        try:
            features, confidence = _seen(synthesizer, attempt)
        except MegraspError as error:
            notes.append(f"attempt {attempt.time} left out: {error}")
            continue
        row = (index // SERIES, features, confidence, attempt.success, attempt.score)
        rows.setdefault(attempt.gripper, []).append(row)
    parts = [_part(name, part) for name, part in sorted(rows.items())]
    success = np.array([row[3] for name in sorted(rows) for row in rows[name]], dtype=bool)
    require_enough(success, "a calibration")
    present = [
        (model.info.calibration_for(part.gripper, part.kind) or Calibration()).of_features(
            part.features
        )
        for part in parts
    ]
    recorded = np.array([row[4] for name in sorted(rows) for row in rows[name]])
    report = {
        "recorded": quality(recorded, success),
        "before": quality(np.concatenate(present), success),
    }
    return parts, report


def recalibrated(
    info: ModelInfo,
    parts: Sequence[JudgedGrasps],
    joint: Calibration,
    by_kind: Mapping[str, Calibration],
) -> ModelInfo:
    """What a model says of itself after it was calibrated for the grippers of `parts`.

    Args:
        info: of the model; kinds of grippers that were not tried keep their calibration.
        parts: that were tried.
        joint: fit to all of them.
        by_kind: fits to kinds with attempts enough for that.
    """
    kinds = dict(info.calibration_by_kind)
    kinds |= {part.kind: by_kind.get(part.kind, joint) for part in parts}
    # What the model was not trained with takes the calibration for all.
    strange = any(part.gripper not in info.trained_grippers for part in parts)
    return replace(
        info,
        calibration=joint if strange or info.calibration is None else info.calibration,
        calibration_by_kind=kinds,
    )


def require_enough(success: np.ndarray, what: str) -> None:
    """Refuse outcomes (N,) that are too few to say anything.

    Raises:
        InvalidRequestError.
    """
    won, lost = int(success.sum()), int((~success).sum())
    if won + lost >= LEAST and min(won, lost) >= LEAST_OF_EACH:
        return
    raise InvalidRequestError(
        f"{won + lost} usable attempts were given, {won} successes and {lost} failures; expected "
        f"at least {LEAST} with {LEAST_OF_EACH} of each for {what}. Record more."
    )


def _seen(synthesizer: GraspSynthesizer, attempt: Attempt) -> tuple[np.ndarray, float]:
    """Features (4,) and confidence of an attempt."""
    mounted = synthesizer.gripper
    if mounted is None or mounted.name != attempt.gripper:
        mounted = synthesizer.set_gripper(load_gripper(attempt.gripper))
    if mounted.hash != attempt.gripper_hash:
        raise InvalidRequestError(
            f"it was made with another description of {attempt.gripper} ({attempt.gripper_hash}, "
            f"now {mounted.hash}); expected the same gripper."
        )
    found = synthesizer.assess(
        Cloud(attempt.points), attempt.world_from_tcp[None], **attempt_options(attempt)
    )
    if found.confidence is None:
        raise InvalidRequestError(
            "the model has no confidence; expected one that was trained with its heads."
        )
    check = found.check
    features = logistic_features(
        found.confidence, check.tilt, check.hidden_share, check.clearance
    )[0]
    return features, float(found.confidence[0])


def _part(gripper: str, rows: list[tuple[int, np.ndarray, float, bool, float]]) -> JudgedGrasps:
    success = np.array([row[3] for row in rows], dtype=bool)
    return JudgedGrasps(
        gripper,
        load_gripper(gripper).description.kind,
        np.array([row[0] for row in rows], dtype=np.int64),
        np.stack([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
        success,
        (int(success.sum()), len(success)),
    )

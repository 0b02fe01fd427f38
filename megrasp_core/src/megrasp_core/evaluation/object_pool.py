"""Which objects an evaluation draws from, and which of them a gripper can hold at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.library import LabelSettings, label_object
from megrasp_core.objects import (
    ObjectModel,
    ObjectSeeds,
    ObjectSet,
    asset_names,
    load_objects,
    procedural_names,
    procedural_object,
    stretched_name,
)

PROCEDURAL_POOL = 60


@dataclass(frozen=True)
class GraspableSettings:
    """When an object counts as graspable: the free-space trial holds it with enough antipodal
    candidates.

    Attributes:
        candidates: drawn.
        trials: of those that start free of collision.
        successes: so many must hold.
        seed: of the candidates.
    """

    candidates: int = 120
    trials: int = 30
    successes: int = 5
    seed: int = 7


def validation_pool(procedural: int = 30, copies: int = 0) -> list[ObjectModel]:
    """Objects for fitting the score: the validation tenth of the train scans (where
    MEGRASP_ASSETS is set), so many stretched copies of each of them, and procedural ones that
    neither training, validation nor evaluation draws.
    """
    scans = asset_names("validation")
    names = [
        *scans,
        *(stretched_name(scans[k % len(scans)], k) for k in range(copies * len(scans))),
        *procedural_names(procedural, ObjectSeeds.CALIBRATION.start),
    ]
    objects = ObjectSet(names)
    return [objects[name] for name in names]


def load_pool(folder: str | Path | None) -> list[ObjectModel]:
    """Objects below a folder, or without one a fixed set of procedural objects.

    Raises:
        ObjectError: the folder holds no object.
    """
    if folder is None:
        return [procedural_object(seed) for seed in ObjectSeeds.EVALUATION.value[:PROCEDURAL_POOL]]
    return load_objects(Path(folder))


def graspable_objects(
    gripper: Gripper,
    pool: list[ObjectModel],
    settings: GraspableSettings | None = None,
    *,
    on_progress: Callable[[int, int], object] | None = None,
) -> list[int]:
    """Indices of the objects that the gripper can hold in the free-space trial.

    Raises:
        InvalidRequestError: it can hold none.
    """
    settings = settings or GraspableSettings()
    labels = LabelSettings(
        count=settings.candidates,
        trials=settings.trials,
        target=settings.successes,
        fresh=1.0,
        failures=0.0,
        hopeless=settings.trials,
    )
    found = []
    for index, model in enumerate(pool):
        made = label_object(gripper, model, settings.seed, settings=labels)
        if int(made.success.sum()) >= settings.successes:
            found.append(index)
        if on_progress is not None:
            on_progress(index + 1, len(pool))
    if not found:
        raise InvalidRequestError(
            f"gripper {gripper.name!r} holds none of the {len(pool)} objects; expected objects "
            "that fit between its fingers. Give another --objects folder."
        )
    return found

"""Trials of a hand's postures on procedural objects, and a file that remembers their outcomes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError
from megrasp_core.evaluation.statistics import wilson
from megrasp_core.grippers import Gripper
from megrasp_core.library import antipodal, cached_gripper
from megrasp_core.objects import procedural_object
from megrasp_core.simulation import FreeSpaceRig, Reason

from .posture_space import PostureSpace

Offsets = tuple[float, ...]


@dataclass(frozen=True)
class Tally:
    """Outcome of trials.

    Attributes:
        drawn: grasps tried.
        blocked: of those, how many began in collision.
        held: of those, how many held the object through the shakes.
        objects: objects with at least one grasp to try.
        objects_held: objects that at least one grasp held.
    """

    drawn: int = 0
    blocked: int = 0
    held: int = 0
    objects: int = 0
    objects_held: int = 0

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(a + b for a, b in zip(vars(self).values(), vars(other).values())))

    def to_json(self) -> dict[str, Any]:
        """Counts and rates with Wilson's intervals."""
        return {
            "grasps": wilson(self.held, self.drawn).to_json(),
            "objects": wilson(self.objects_held, self.objects).to_json(),
            "start_collisions": self.blocked,
        }


@dataclass(frozen=True)
class Task:
    """One unit of work: a posture on one object."""

    offsets: Offsets
    object_seed: int
    candidates: int
    timestep: float


def measure(task: Task, gripper: str, seed: int) -> Tally:
    """Try antipodal grasps of one object with the postures moved by the task's offsets.

    The grasps depend on object and seed, not on the postures: all postures meet the same ones.
    """
    space = PostureSpace(cached_gripper(gripper))
    hand = Gripper(space.describe(task.offsets))
    model = procedural_object(task.object_seed)
    rng = np.random.default_rng([seed, task.object_seed])
    poses = antipodal(model, hand, task.candidates, rng).object_from_gripper
    if not len(poses):
        return Tally()
    rig = FreeSpaceRig(hand, model, timestep=task.timestep)
    results = [rig.trial(pose) for pose in poses]
    held = sum(result.success for result in results)
    blocked = sum(result.reason is Reason.START_COLLISION for result in results)
    return Tally(len(poses), blocked, held, 1, int(held > 0))


class TrialMemory:
    """Outcomes by task, kept in a file of JSON lines where one is given.

    Args:
        file: written to after every task, continued where it exists; None keeps nothing.
        head: what all outcomes depend on besides their task.

    Raises:
        DataError: the file was written with another head.
    """

    def __init__(self, file: Path | None, head: dict[str, Any]) -> None:
        self._file = file
        self._known: dict[Task, Tally] = {}
        if file is None:
            return
        file.parent.mkdir(parents=True, exist_ok=True)
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        first, *lines = text.splitlines() or [json.dumps(head)]
        if first != json.dumps(head):
            raise DataError(
                f"{file} holds trials of {first}; expected {json.dumps(head)}. Delete it, or give "
                "another --out."
            )
        whole = [first]
        for line in lines:
            try:
                offsets, seed, candidates, timestep, *counts = json.loads(line)
                self._known[Task(tuple(offsets), seed, candidates, timestep)] = Tally(*counts)
            except (ValueError, TypeError):
                continue  # a run that was killed leaves half a line behind
            whole.append(line)
        file.write_text("\n".join(whole) + "\n", encoding="utf-8")

    def __contains__(self, task: Task) -> bool:
        return task in self._known

    def __getitem__(self, task: Task) -> Tally:
        return self._known[task]

    def keep(self, task: Task, tally: Tally) -> None:
        """Remember an outcome, at once also in the file."""
        self._known[task] = tally
        if self._file is not None:
            values = [*vars(task).values(), *vars(tally).values()]
            with self._file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(values) + "\n")

"""The rules by which a bin is emptied: which gripper is due, what counts as a try, when to stop.

One plan serves the demo without ROS (`demo.py`) and the ROS node `bin_clearing`, so that both
empty a bin in the same way. It knows nothing of the cell: it hears of attempts and answers what to
do next.

Rules, with `tries` = 3 by default:

* The objects are shared out evenly over the grippers, the first ones taking what is left over. A
  gripper hands over as soon as its share has left the bin.
* Tries are counted as failures in a row. A failed grasp, and a synthesis that offers no grasp to
  execute, count one. Grasps within `exclude_radius` of TCP poses that failed are excluded from the
  next synthesis; those that failed before the last success are allowed again when something
  beside them was lifted, or when no other grasp is found (`FailureMemory`).
* After `tries` failures in a row the object that they were aimed at is given up for this gripper:
  grasps whose TCP lies within `give_up_radius` of the failed ones are passed over from then on.
* When as many objects are given up as are left in the bin, or `tries` syntheses in a row offered
  nothing, the gripper hands over; if it was the last, the run ends. A bin of n objects thus sees
  at most `tries` * n attempts of a gripper, and every run ends.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .failure_memory import FailureMemory

FAILURES = {
    "no_grasp": "no grasp was found",
    "given_up": "all grasps are aimed at objects that were given up",
    "start_collision": "the open gripper would hit something where it is to close",
    "approach_collision": "the open gripper would hit something on its way",
    "no_contact": "the fingers closed on nothing",
    "unexpected_width": "the fingers stopped elsewhere than on what was seen",
    "slipped": "it was held after closing and lost later",
    "not_lifted": "it was held and did not come up",
    "obstacle": "it closed on what may not be lifted",
    "bin": "it pulled at the bin",
    "unstable": "the simulation diverged",
    "other": "the cell gives another reason",
}
"""Why an attempt failed: the one vocabulary of records and logs, with what each word means."""


@dataclass(frozen=True)
class PickRecord:
    """One attempt, as printed and as kept in summary.json.

    Attributes:
        attempt: number, from 1.
        gripper: name.
        success: something was lifted.
        reason: why not, in the cell's own words, "" after a success.
        removed: names of the objects that are out.
        objects_left: in the bin.
        score: of the executed grasp; None where there was none.
        width: what it was to close on (m).
        width_tolerance: how well that was known (m).
        closed_width: where the fingers stood after closing (m).
        returned: grasps of the answer.
        synthesis_seconds: wall time of the answer.
        execution_seconds: wall time of the attempt.
        rejected: poses that were drawn and left out, by reason.
        picture: file, where one was drawn.
    """

    attempt: int
    gripper: str
    success: bool
    reason: str
    removed: tuple[str, ...]
    objects_left: int
    score: float | None = None
    width: float | None = None
    width_tolerance: float | None = None
    closed_width: float | None = None
    returned: int = 0
    synthesis_seconds: float = 0.0
    execution_seconds: float = 0.0
    rejected: dict[str, int] = field(default_factory=dict)
    picture: str | None = None

    @property
    def as_expected(self) -> bool | None:
        """Whether the fingers stood where the grasp said: what a cell can see without a camera.
        None where that is not known.
        """
        numbers = (self.width, self.width_tolerance, self.closed_width)
        if any(number is None or math.isnan(number) for number in numbers):
            return None
        width, tolerance, closed = (float(number or 0.0) for number in numbers)
        return abs(closed - width) <= tolerance

    @property
    def failure(self) -> str:
        """What went wrong, as a key of `FAILURES`; "" where nothing did.

        Also after a success: what was lifted with the fingers elsewhere than expected is another
        object, or more than one.
        """
        first = self.reason.partition(" ")[0]
        if not self.success and first in FAILURES:
            return first
        if self.as_expected is False:
            return "unexpected_width"
        return "" if self.success else "other"

    def line(self) -> str:
        """One line for a terminal."""
        what = ", ".join(self.removed) if self.removed else "nothing"
        score = "  -  " if self.score is None else f"{self.score:5.2f}"
        fingers = ""
        if self.as_expected is not None:
            closed, width = 1000 * (self.closed_width or 0.0), 1000 * (self.width or 0.0)
            word = "as" if self.as_expected else "not as"
            fingers = f", fingers at {closed:.0f} mm ({word} expected: {width:.0f})"
        outcome = f"lifted {what}"
        if not self.success:
            told = self.reason if self.failure == "other" else FAILURES[self.failure]
            outcome = f"failed ({self.failure}: {told}), removed {what}"
        return (
            f"pick {self.attempt:2d}  {self.gripper:<14s} score {score}  {outcome}{fingers}; "
            f"{self.objects_left} left  [{self.returned} grasps in {self.synthesis_seconds:.2f} "
            f"s, executed in {self.execution_seconds:.2f} s]"
        )


class ClearingPlan:
    """Which gripper is due and what it must not try again, after all attempts so far."""

    def __init__(
        self,
        grippers: Sequence[str],
        objects: int,
        *,
        tries: int = 3,
        give_up_radius: float = 0.05,
        exclude_radius: float = 0.05,
    ) -> None:
        """`objects`: how many are in the bin. Raises InvalidRequestError for bad numbers."""
        if not grippers:
            raise InvalidRequestError(
                "no gripper was given for clearing the bin; expected one or more names, used in "
                "this order"
            )
        if tries < 1 or objects < 0:
            raise InvalidRequestError(
                f"tries = {tries} and objects = {objects} were given; expected at least 1 try "
                "and 0 objects"
            )
        self.grippers = tuple(grippers)
        self.tries = tries
        self.give_up_radius = give_up_radius
        self.exclude_radius = exclude_radius
        self.objects_at_start = objects
        self.objects_left = objects
        self.records: list[PickRecord] = []
        self.ended = "" if objects else "the bin is empty"
        self._turn = 0
        self.failures = FailureMemory()
        self._without_grasp = 0
        self._given_up: list[np.ndarray] = []
        self._objects_given_up = 0

    @property
    def gripper(self) -> str | None:
        """The gripper that is due, or None when the run is over."""
        return None if self.ended else self.grippers[self._turn]

    def choose(self, world_from_tcp: Sequence[np.ndarray] | np.ndarray) -> int | None:
        """Index of the first pose (n, 4, 4), best first, not aimed at a given-up object."""
        for index, pose in enumerate(np.asarray(world_from_tcp, dtype=float).reshape(-1, 4, 4)):
            near = (
                np.linalg.norm(pose[:3, 3] - spot) < self.give_up_radius for spot in self._given_up
            )
            if not any(near):
                return index
        return None

    def record(self, record: PickRecord, world_from_tcp: np.ndarray | None) -> None:
        """Takes in one attempt. `world_from_tcp` (4, 4): what was executed, None for no grasp."""
        self.records.append(record)
        self.objects_left = record.objects_left
        self.failures.count(record.success, world_from_tcp)
        nothing = world_from_tcp is None and not record.success
        self._without_grasp = self._without_grasp + 1 if nothing else 0
        if self.failures.in_a_row >= self.tries:
            self._objects_given_up += 1
            self._given_up.extend(pose[:3, 3] for pose in self.failures.recent)
            self.failures.give_up()
        self._advance()

    def stop(self, reason: str) -> None:
        """Ends the run, for instance because the cell or the server no longer answers."""
        self.ended = self.ended or reason

    def summary(self) -> dict[str, object]:
        """Counts over the run and every attempt, ready for JSON."""
        successes = sum(record.success for record in self.records)
        removed = [name for record in self.records for name in record.removed]
        failures = Counter(record.failure for record in self.records if record.failure)
        per_gripper: dict[str, dict[str, int]] = {}
        for record in self.records:
            row = per_gripper.setdefault(
                record.gripper, {"attempts": 0, "successes": 0, "removed": 0}
            )
            row["attempts"] += 1
            row["successes"] += record.success
            row["removed"] += len(record.removed)
        return {
            "grippers": list(self.grippers),
            "objects_at_start": self.objects_at_start,
            "objects_left": self.objects_left,
            "removed": removed,
            "cleared": self.objects_left == 0,
            "attempts": len(self.records),
            "successes": successes,
            "first_grasp_rate": successes / len(self.records) if self.records else None,
            "per_gripper": per_gripper,
            "failures": dict(failures),
            "tries_an_object": self.tries,
            "ended": self.ended,
            "picks": [_json_ready(record) for record in self.records],
        }

    def _advance(self) -> None:
        if self.objects_left == 0:
            self.ended = "the bin is empty"
            return
        out = self.objects_at_start - self.objects_left
        share_done = self._turn + 1 < len(self.grippers) and out >= self._share(self._turn + 1)
        stuck = self._objects_given_up >= self.objects_left or self._without_grasp >= self.tries
        if not (share_done or stuck):
            return
        if self._turn + 1 == len(self.grippers):
            self.ended = (
                f"no grasp was found {self.tries} times in a row"
                if self._without_grasp >= self.tries
                else f"{self.objects_left} objects were given up after {self.tries} tries each"
            )
            return
        self._turn += 1
        self.failures.clear()
        self._given_up.clear()
        self._without_grasp = self._objects_given_up = 0

    def _share(self, turns: int) -> int:
        """Objects that must be out before the gripper number `turns` is due."""
        return -(-self.objects_at_start * turns // len(self.grippers))


def _json_ready(record: PickRecord) -> dict[str, object]:
    """The record with null for numbers that are not defined, which JSON has no word for."""
    told = asdict(record) | {"as_expected": record.as_expected, "failure": record.failure}
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in told.items()
    }

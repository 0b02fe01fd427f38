"""Which open and closed postures of a hand hold the most objects, measured by free-space trials.

Random variations of the listed postures compete by successive halving: all of them try a few
procedural objects, the best third tries three times as many, and so on; each further round draws
its variations closer around the best so far. What is found is then measured, beside the listed
postures, on objects that the search has not seen.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import CancelledError, SimulationError
from megrasp_core.jobs import ExecutorConfig, run_units
from megrasp_core.library import cached_gripper
from megrasp_core.objects import ObjectSeeds
from megrasp_core.ranges import COUNT, FROM_ONE, POSITIVE, check_ranges

from .posture_space import PostureSpace
from .posture_trials import Offsets, Tally, Task, TrialMemory, measure

SEARCH_SEED = ObjectSeeds.POSTURE_SEARCH.start
HELD_OUT_SEED = ObjectSeeds.POSTURE_MEASUREMENT.start
"""First procedural objects of the search and of the final measurement."""

KEPT = 3
"""One in this many variations goes on to as many times the objects."""

FINAL_TIMESTEP = 0.002
"""Of the final measurement (s), that of the verdict: finer than labels take."""


@dataclass(frozen=True)
class PostureSearchSettings:
    """Effort of a search.

    Attributes:
        variants: postures tried in the first rung of a round, the best so far among them.
        rounds: rounds; each draws around the best of the one before.
        objects: objects of a round's first rung.
        candidates: grasps tried per object and posture.
        scale: standard deviation of the first round's offsets, as a share of each joint's range.
        shrink: factor on `scale` from round to round.
        held_out: objects of the final measurement.
        held_out_candidates: grasps per object there.
        timestep: of the search's trials (s); the final measurement takes `FINAL_TIMESTEP`.
        seed: of offsets and candidates.
    """

    variants: int = 81
    rounds: int = 3
    objects: int = 4
    candidates: int = 6
    scale: float = 0.15
    shrink: float = 0.6
    held_out: int = 120
    held_out_candidates: int = 10
    timestep: float = 0.004
    seed: int = 0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            variants=FROM_ONE,
            rounds=COUNT,
            objects=FROM_ONE,
            candidates=FROM_ONE,
            scale=POSITIVE,
            shrink=POSITIVE,
            held_out=FROM_ONE,
            held_out_candidates=FROM_ONE,
            timestep=POSITIVE,
            seed=COUNT,
        )


@dataclass
class PostureSearch:
    """A search and its memory of trials.

    Attributes:
        gripper: registered name or folder of a hand.
        settings: effort.
        memory: file that keeps every outcome, so that a search that was stopped goes on; None
            keeps none.
        executor: where to run.
        on_progress: called with (tasks done, tasks expected) after every task.

    Raises:
        InvalidRequestError: the gripper is no hand.
        DataError: the memory belongs to another gripper, an older version of it, or another seed.
    """

    gripper: str
    settings: PostureSearchSettings = field(default_factory=PostureSearchSettings)
    memory: Path | None = None
    executor: ExecutorConfig | None = None
    on_progress: Callable[[int, int], None] | None = None

    def __post_init__(self) -> None:
        self.space = PostureSpace(cached_gripper(self.gripper))
        head = {"gripper_hash": self.space.gripper.hash, "seed": self.settings.seed}
        self._known = TrialMemory(self.memory, head)
        self._used: set[Task] = set()

    def run(self) -> dict[str, Any]:
        """Search, then measure the listed and the found postures on unseen objects.

        Returns:
            What the result file holds: settings, directions, postures, counts and intervals.

        Raises:
            CancelledError: stopped by Ctrl-C; the memory holds what was done.
            SimulationError: trials failed.
        """
        settings = self.settings
        listed: Offsets = (0.0,) * len(self.space)
        best = listed
        rng = np.random.default_rng(settings.seed)
        for index in range(settings.rounds):
            scale = settings.scale * settings.shrink**index
            drawn = [self.space.draw(best, scale, rng) for _ in range(settings.variants - 1)]
            best = self._round(list(dict.fromkeys([best, *drawn])))
        seeds = [HELD_OUT_SEED + i for i in range(settings.held_out)]
        search = [SEARCH_SEED + i for i in range(self.rungs()[-1][1])] if settings.rounds else []
        entry: dict[str, Any] = {}
        for name, offsets in (("listed", listed), ("found", best)):
            description = self.space.describe(offsets).to_dict()
            entry[name] = {
                "offsets": list(offsets),
                "postures": description["postures"],
                "search": self._tally(offsets, search).to_json(),
                "held_out": self._tally(offsets, seeds, final=True).to_json(),
            }
        return {
            "gripper": self.space.gripper.name,
            "gripper_hash": self.space.gripper.hash,
            "settings": asdict(settings),
            "directions": [
                {"joints": dict(direction.joints), "span": direction.span}
                for direction in self.space.directions
            ],
            "trials": sum(self._known[task].drawn for task in self._used),
            **entry,
        }

    def rungs(self) -> list[tuple[int, int]]:
        """(variants, objects) of each rung of a round."""
        out = [(self.settings.variants, self.settings.objects)]
        while out[-1][0] > KEPT:
            out.append((max(1, out[-1][0] // KEPT), out[-1][1] * KEPT))
        return out

    def _expected(self) -> int:
        """Tasks of the whole search, where no variation comes twice."""
        tasks, before = 0, 0
        for variants, objects in self.rungs():
            tasks += variants * (objects - before)
            before = objects
        both = 2 if self.settings.rounds else 1
        return self.settings.rounds * tasks + both * (self.settings.held_out + before)

    def _round(self, variants: list[Offsets]) -> Offsets:
        """Successive halving among the variants; the first wins where rates are equal."""
        for kept, objects in self.rungs():
            variants = variants[:kept]
            seeds = [SEARCH_SEED + i for i in range(objects)]
            self._do([self._task(offsets, seed) for offsets in variants for seed in seeds])
            scores = {offsets: self._tally(offsets, seeds) for offsets in variants}
            variants.sort(key=lambda v: (-scores[v].held, -scores[v].objects_held))
        return variants[0]

    def _task(self, offsets: Offsets, seed: int, final: bool = False) -> Task:
        if final:
            return Task(offsets, seed, self.settings.held_out_candidates, FINAL_TIMESTEP)
        return Task(offsets, seed, self.settings.candidates, self.settings.timestep)

    def _tally(self, offsets: Offsets, seeds: Sequence[int], final: bool = False) -> Tally:
        tasks = [self._task(offsets, seed, final) for seed in seeds]
        self._do(tasks)
        return sum((self._known[task] for task in tasks), Tally())

    def _do(self, tasks: list[Task]) -> None:
        """Run the tasks whose outcome is not known."""
        self._used.update(tasks)
        missing = [task for task in dict.fromkeys(tasks) if task not in self._known]
        if not missing:
            return
        before = len(self._used) - len(missing)
        total = max(len(self._used), self._expected())
        summary = run_units(
            functools.partial(measure, gripper=self.gripper, seed=self.settings.seed),
            missing,
            self.executor,
            on_result=self._known.keep,
            on_progress=lambda state: self._tell(before + state.done + state.failed, total),
        )
        if summary.cancelled:
            raise CancelledError(
                f"the posture search was stopped after {before + summary.done} tasks; run the "
                "same command again to go on."
            )
        if summary.failed:
            task, message = summary.failed[0]
            raise SimulationError(
                f"{len(summary.failed)} of {len(missing)} tasks of the posture search failed, "
                f"first that of object {task.object_seed} with offsets {task.offsets}: {message}"
            )

    def _tell(self, done: int, total: int) -> None:
        if self.on_progress is not None:
            self.on_progress(done, total)

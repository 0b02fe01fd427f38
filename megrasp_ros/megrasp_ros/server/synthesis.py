"""One synthesis, from a request to an outcome; runs in the worker thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from megrasp_msgs.msg import ErrorCode, GraspArray
from numpy.typing import NDArray
from std_msgs.msg import Header

from megrasp_ros.errors import BinEmptyError

from .engine import Engine, best_of
from .grasp_messages import Outcome, grasp_array, rejection_counts, timing_message, unfinished
from .parameters import Settings
from .requests import ParsedRequest
from .sensing import Sensing
from .worker import Job

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.synthesizer import PoseSet

FloatArray = NDArray[np.float64]
OnStep = Callable[[str, int, int, GraspArray | None], None]
"""(phase, step, total_steps, unfinished and unchecked grasps where there are any)."""
SEED_MASK = 2**63 - 1
_PHASES = {"rank": "check"}
"""The core's phase names -> those of GenerateGrasps.action."""


@dataclass(frozen=True, eq=False)
class Computed:
    """An outcome, the gripper it is for, and the points (N, 3) it was computed from, in the
    planning frame.
    """

    outcome: Outcome
    gripper: Gripper
    points: FloatArray


class SynthesisRunner:
    """The steps of a request: wait for the cloud, bring it into the planning frame, synthesize,
    make messages.
    """

    def __init__(self, engine: Engine, sensing: Sensing) -> None:
        self._engine = engine
        self._sensing = sensing

    def run(
        self,
        job: Job,
        request: ParsedRequest,
        settings: Settings,
        grippers: list[Gripper],
        on_step: OnStep | None = None,
        *,
        mounted: str = "",
    ) -> Computed:
        """Return the outcome for the best of `grippers` (usually one).

        mounted: name of the one that is on the arm; others cost `settings.swap_cost`.

        Errors of the request, the cloud and the model are raised; that no grasp was found is an
        outcome, since it comes with counts.
        """
        step = on_step or (lambda phase, index, total, grasps=None: None)
        step("wait", 0, 0, None)
        exclude = request.excluded(job.check)
        queued = job.elapsed
        sensed = self._sensing.sense(
            job,
            settings,
            given=request.cloud,
            not_before=request.not_before,
            region=request.region,
            target=request.target,
            on_arrived=lambda: step("perceive", 0, 1, None),
        )
        options = options_of(request, settings, sensed.gravity)
        with sensed.placed():
            results = [
                (
                    gripper,
                    self._engine.synthesize(
                        gripper,
                        sensed.cloud,
                        exclude=exclude,
                        cancelled=job.should_stop,
                        **self._told(gripper, sensed.header, request.seed, step),
                        **options,
                    ),
                )
                for gripper in grippers
            ]
        gripper, synthesis = best_of(results, mounted, settings.swap_cost)
        if synthesis.bin_empty:
            raise BinEmptyError(
                "only the support surface is left in the "
                f"{'region' if request.region is not None else 'cloud'}; expected objects of at "
                "least 10 mm height. The bin is empty; fill it, or check the region."
            )
        outcome = Outcome(
            grasps=grasp_array(
                gripper,
                synthesis.grasps,
                header=sensed.header,
                model_id=self._engine.model_id,
                seed=request.seed,
            ),
            timing=timing_message(
                synthesis.timing,
                wait=queued + sensed.waited,
                perceive=sensed.seconds,
                total=job.elapsed,
            ),
            rejected=rejection_counts(synthesis.rejected),
            notes=(*synthesis.notes, *_compared(results, mounted, settings.swap_cost)),
        )
        if not synthesis.grasps:
            outcome.error_code = ErrorCode.NO_GRASP_FOUND
            outcome.error_msg = no_grasp_text(
                synthesis.drawn, synthesis.rejected, gripper.name, synthesis.hints
            )
        return Computed(outcome, gripper, sensed.cloud.points)

    def _told(
        self, gripper: Gripper, header: Header, seed: int, step: OnStep
    ) -> dict[str, Callable[..., None]]:
        """Return the core's callbacks: unfinished poses come after the step they belong to."""
        at = ("sample", 0, 0)

        def on_step(phase: str, index: int, total: int) -> None:
            nonlocal at
            at = (_PHASES.get(phase, phase), index, total)
            step(*at, None)

        def on_poses(poses: PoseSet) -> None:
            grasps = unfinished(
                gripper, poses, header=header, model_id=self._engine.model_id, seed=seed
            )
            step(*at, grasps)

        return {"on_step": on_step, "on_poses": on_poses}


def options_of(request: ParsedRequest, settings: Settings, gravity: FloatArray) -> dict[str, Any]:
    """Return the attributes of the core's SynthesisRequest; the poses to exclude are left out."""
    return {
        "num_grasps": request.num_grasps,
        "drawn": max(settings.drawn, request.num_grasps),
        "more_rounds": settings.more_rounds,
        "gravity": gravity,
        "region": request.region,
        "walls": settings.region_walls,
        "floor": settings.floor,
        "assume_empty": settings.assume_empty,
        "max_tilt": request.max_tilt if request.max_tilt < np.pi else None,
        "approach_distance": settings.approach_distance,
        "approach_direction": settings.approach_direction,
        "exclude_radius": request.exclude_radius,
        "target": request.target,
        "min_score": request.min_score,
        "mode": request.mode,
        "prefer": request.prefer,
        # The core's seeds have one bit less than those of the message.
        "seed": request.seed & SEED_MASK,
    }


def _compared(
    results: list[tuple[Gripper, Any]], mounted: str, swap_cost: float
) -> tuple[str, ...]:
    """Return what the grippers of a rack came to, for `auto`."""
    if len(results) < 2:
        return ()
    told = []
    for gripper, synthesis in results:
        best = f"{synthesis.grasps[0].score:.2f}" if synthesis.grasps else "no grasp"
        cost = "" if gripper.name == mounted else f" less {swap_cost:g} for changing the tool"
        told.append(f"{gripper.name} {best}{cost}")
    return (f"of the rack: {'; '.join(told)}.",)


def no_grasp_text(drawn: int, rejected: dict[str, int], gripper: str, hints: Sequence[str]) -> str:
    """Return the message of error 400: counts by reason, and what to do."""
    counts = (
        ", ".join(f"{reason} {count}" for reason, count in rejected.items() if count)
        or "no reason counted"
    )
    told = " ".join(hints) or "Check the region and the cloud."
    return (
        f"none of {drawn} drawn grasps of {gripper} was kept ({counts}). {told} Or raise the "
        "parameter drawn."
    )

"""One synthesis, from a request to an outcome; runs in the worker thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from megrasp_msgs.msg import ErrorCode, GraspArray
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from megrasp_ros.conversions import points_from_cloud
from megrasp_ros.errors import BinEmptyError

from .clouds import CloudSource
from .engine import Engine, best_of
from .frames import FrameSource, gravity_in, is_optical
from .grasp_messages import Outcome, grasp_array, rejection_counts, timing_message, unfinished
from .parameters import Settings
from .requests import ParsedRequest
from .worker import Job

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.pointcloud import Cloud
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

    def __init__(self, engine: Engine, clouds: CloudSource, frames: FrameSource) -> None:
        self._engine = engine
        self._clouds = clouds
        self._frames = frames

    def run(
        self,
        job: Job,
        request: ParsedRequest,
        settings: Settings,
        grippers: list[Gripper],
        on_step: OnStep | None = None,
    ) -> Computed:
        """Return the outcome for the best of `grippers` (usually one).

        Errors of the request, the cloud and the model are raised; that no grasp was found is an
        outcome, since it comes with counts.
        """
        step = on_step or (lambda phase, index, total, grasps=None: None)
        step("wait", 0, 0, None)
        exclude = request.excluded(job.check)
        message = request.cloud
        if message is not None:
            self._clouds.check_given(message, request.not_before)
        else:
            message = self._clouds.wait(
                job,
                timeout=settings.cloud_timeout,
                max_age=settings.cloud_max_age,
                not_before=request.not_before,
            )
        waited = job.elapsed
        step("perceive", 0, 1, None)
        perceived = time.monotonic()
        cloud, header, gravity = self._perceive(message, request, settings)
        job.check()
        perceive = time.monotonic() - perceived
        options = self._options(job, request, settings, gravity)
        results = [
            (
                gripper,
                self._engine.synthesize(
                    gripper,
                    cloud,
                    exclude=exclude,
                    **self._told(gripper, header, request.seed, step),
                    **options,
                ),
            )
            for gripper in grippers
        ]
        gripper, synthesis = best_of(results)
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
                header=header,
                model_id=self._engine.model_id,
                seed=request.seed,
            ),
            timing=timing_message(
                synthesis.timing, wait=waited, perceive=perceive, total=job.elapsed
            ),
            rejected=rejection_counts(synthesis.rejected),
            notes=synthesis.notes,
        )
        if not synthesis.grasps:
            outcome.error_code = ErrorCode.NO_GRASP_FOUND
            outcome.error_msg = no_grasp_text(
                synthesis.drawn, synthesis.rejected, gripper.name, synthesis.hints
            )
        return Computed(outcome, gripper, cloud.points)

    def _perceive(
        self, message: PointCloud2, request: ParsedRequest, settings: Settings
    ) -> tuple[Cloud, Header, FloatArray]:
        """Return the cloud in the planning frame, the header of the answer and gravity (3,) in
        that frame.
        """
        frame, planning_from_cloud = self._frames.planning_from_cloud(message.header, settings)
        gravity = gravity_in(frame, settings)
        points = points_from_cloud(message)
        region = request.region
        if region is not None:
            region = region.transformed(np.linalg.inv(planning_from_cloud))
        # Gravity is looked at in the planning frame, with everything else, before the synthesis.
        from megrasp_core.pointcloud import Cloud, check_view

        check_view(points, region=region, optical=is_optical(message.header.frame_id))
        cloud = Cloud(points, None, settings.sensor_origin).transformed(planning_from_cloud)
        return cloud, Header(stamp=message.header.stamp, frame_id=frame), gravity

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

    def _options(
        self, job: Job, request: ParsedRequest, settings: Settings, gravity: FloatArray
    ) -> dict[str, Any]:
        return {
            "num_grasps": request.num_grasps,
            "drawn": max(settings.drawn, request.num_grasps),
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
            "cancelled": job.should_stop,
        }


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

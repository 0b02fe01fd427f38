"""One synthesis with everything that is needed to explain it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from megrasp_core.errors import (
    CloudError,
    EmptyRegionError,
    GravityError,
    InvalidRequestError,
    MegraspError,
)
from megrasp_core.grippers import Gripper
from megrasp_core.pointcloud import Cloud
from megrasp_core.ranking import FEATURES, Calibration, logistic_features
from megrasp_core.synthesizer import (
    GraspSynthesizer,
    RankedGrasp,
    Synthesis,
    SynthesisRequest,
    Trace,
)

from .near_miss import NearMiss, near_misses
from .setup_findings import SetupFindings, setup_findings

__all__ = ["Explanation", "explain", "refused"]


@dataclass(frozen=True, eq=False)
class Explanation:
    """A synthesis, or why there was none.

    Attributes:
        cloud: in the coordinates of the trace.
        request: in the same.
        gripper: whose grasps were asked for.
        setup: region, floor and sensor held against the cloud.
        answer: in the frame of the cloud as it was given; None where it was refused.
        trace: of the synthesis; None where it was refused.
        refusal: what was wrong with cloud or request, "" where nothing was.
        misses: the best near miss of each main reason.
        calibration: that the scores were made with; None where the cloud was refused.
    """

    cloud: Cloud
    request: SynthesisRequest
    gripper: Gripper
    setup: SetupFindings
    answer: Synthesis | None = None
    trace: Trace | None = None
    refusal: str = ""
    misses: tuple[NearMiss, ...] = ()
    calibration: Calibration | None = None

    @property
    def returned(self) -> list[RankedGrasp]:
        """The grasps that were found, best first."""
        return [] if self.answer is None else [g for g in self.answer.grasps if g.collision_free]

    @property
    def causes(self) -> tuple[str, ...]:
        """Why there are no grasps, or no more: the likeliest first."""
        empty = self.answer is not None and self.answer.bin_empty
        told = [
            *([self.refusal] if self.refusal else []),
            *self.setup.told,
            *([EMPTY] if empty else []),
            *(self.answer.hints if self.answer else ()),
        ]
        return tuple(dict.fromkeys(told))

    def terms(self, grasp: RankedGrasp) -> dict[str, float]:
        """What the logit of a grasp's score is the sum of: the bias, and what each feature adds;
        empty without a confidence.
        """
        if self.calibration is None or not np.isfinite(grasp.confidence):
            return {}
        features = logistic_features(
            *(np.array([v]) for v in
              (grasp.confidence, grasp.tilt, grasp.hidden_share, grasp.clearance))
        )  # fmt: skip
        added = self.calibration.terms(features)[0].tolist()
        return {n: round(v, 3) for n, v in zip(("bias", *FEATURES), added, strict=True)}


EMPTY = (
    "only the support surface is left: nothing stands out of it by 10 mm. Check the region if "
    "there is something."
)


def explain(
    synthesizer: GraspSynthesizer,
    cloud: Cloud,
    request: SynthesisRequest,
    *,
    on_step: Callable[[str, int, int], None] | None = None,
) -> Explanation:
    """Synthesize and keep what is needed to explain the answer, or the refusal.

    Args:
        synthesizer: with a gripper set.
        cloud: as of `GraspSynthesizer.synthesize`.
        request: what is asked for.
        on_step: as of `GraspSynthesizer.synthesize`.

    Raises:
        InvalidRequestError: no gripper is set.
    """
    gripper = synthesizer.gripper
    if gripper is None:
        raise InvalidRequestError("no gripper is set; expected one. Call set_gripper first.")
    traces: list[Trace] = []
    try:
        answer = synthesizer.synthesize(cloud, request, on_step=on_step, on_trace=traces.append)
    except (CloudError, EmptyRegionError, GravityError, InvalidRequestError) as error:
        return refused(cloud, request, gripper, error)
    (trace,) = traces
    cloud = cloud.moved(-trace.offset)
    settings = synthesizer.calibrated.ranking
    return Explanation(
        cloud,
        trace.request,
        gripper,
        setup_findings(cloud, trace.request, trace.observation, trace.offset),
        answer,
        trace,
        misses=tuple(near_misses(trace, settings)),
        calibration=settings.rank.calibration or Calibration(),
    )


def refused(
    cloud: Cloud, request: SynthesisRequest, gripper: Gripper, error: MegraspError
) -> Explanation:
    """The explanation where an error came in the way of a synthesis."""
    try:
        setup = setup_findings(cloud, request)
    except MegraspError:
        setup = SetupFindings(())
    if request.sensor is None and cloud.viewpoint is not None:
        request = replace(request, sensor=cloud.viewpoint)
    return Explanation(cloud, request, gripper, setup, refusal=str(error))

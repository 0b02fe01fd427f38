"""From assessed poses to the list that is returned, and the count of why the others were not."""

from __future__ import annotations

import numpy as np

from megrasp_core.ranking import GripperProbe, rejection_counts, suppress_duplicates

from .evaluate import Assessment
from .poses import PoseSet
from .request import SynthesisRequest
from .result import RankedGrasp
from .settings import RankingSettings

__all__ = ["Assessed", "collect"]

Assessed = tuple[PoseSet, Assessment]


def collect(
    final: Assessed,
    rest: tuple[Assessed, np.ndarray] | None,
    probe: GripperProbe,
    request: SynthesisRequest,
    settings: RankingSettings,
) -> tuple[list[RankedGrasp], dict[str, int]]:
    """Best first, without near duplicates, at most num_grasps.

    Args:
        final: poses that went through everything.
        rest: all drawn poses as they were before the restarts, and the indices of those that went
            no further.
        probe: of the gripper, for its symmetry.
        request: number of grasps; whether those that fail are wanted too.
        settings: duplicates.

    Returns:
        Grasps, and the number of drawn poses per reason. Returned grasps that pass and all counts
        make `drawn`.
    """
    poses, assessment = final
    check, score = assessment.check, assessment.score
    passing = np.flatnonzero(check.passed)
    repeats = suppress_duplicates(
        poses.tcp[passing], score[passing], probe.symmetry, settings.rank
    )
    check.reason[passing[repeats]] = "duplicate"
    good = passing[~repeats]
    good = good[np.argsort(-score[good], kind="stable")]
    check.reason[good[request.num_grasps :]] = "surplus"
    grasps = [_grasp(poses, assessment, i, "") for i in good[: request.num_grasps]]
    reasons = check.reason
    if rest is not None:
        others, index = rest
        reasons = np.concatenate([reasons, _unrefined(others[1], index)])
    if request.keep_all:
        left = [(final, np.flatnonzero(reasons[: len(check.reason)] != ""))]
        for source, index in left if rest is None else [*left, rest]:
            room = request.num_grasps - len(grasps)
            for i in _better_first(source[1], index)[:room]:
                grasps.append(_grasp(source[0], source[1], i, str(source[1].check.reason[i])))
    return grasps, rejection_counts(reasons)


def _better_first(assessment: Assessment, index: np.ndarray) -> np.ndarray:
    """Repeats of a good grasp and poses that nobody had room for, then those that fail, each by
    score.
    """
    failing = ~np.isin(assessment.check.reason[index], ("duplicate", "surplus"))
    return index[np.lexsort((-assessment.score[index], failing))]


def _unrefined(assessment: Assessment, index: np.ndarray) -> np.ndarray:
    """Reasons of the poses that did not go through the restarts."""
    reasons = assessment.check.reason
    reasons[index[reasons[index] == ""]] = "surplus"
    return reasons[index]


def _grasp(poses: PoseSet, assessment: Assessment, i: int, reason: str) -> RankedGrasp:
    check, contacts, confidence = assessment.check, assessment.contacts, assessment.confidence
    free = reason in ("", "duplicate", "surplus")
    return RankedGrasp(
        world_from_tcp=poses.tcp[i],
        world_from_gripper=poses.gripper[i],
        world_from_gripper_approach=poses.approach[i],
        score=float(assessment.score[i]),
        width=float("nan") if contacts is None else float(contacts.width[i]),
        clearance=float(check.clearance[i]),
        tilt=float(check.tilt[i]),
        collision_free=free,
        reason=reason,
        confidence=float("nan") if confidence is None else float(confidence[i]),
        hidden_share=float(check.hidden_share[i]),
    )

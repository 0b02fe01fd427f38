"""From assessed poses to the list that is returned, and the count of why the others were not."""

from __future__ import annotations

import numpy as np

from megrasp_core.ranking import GripperProbe, rejection_counts, suppress_duplicates

from .request import LAYER, SynthesisRequest
from .result import RankedGrasp
from .scene_judge import Assessment
from .settings import RankingSettings

__all__ = ["rank_poses"]

PASSED = ("", "duplicate", "surplus")
"""Reasons of poses that passed the whole check."""


def rank_poses(
    assessed: Assessment,
    probe: GripperProbe,
    request: SynthesisRequest,
    settings: RankingSettings,
    left_out: tuple[Assessment, np.ndarray] | None = None,
) -> tuple[list[RankedGrasp], dict[str, int]]:
    """Best first, without near duplicates, at most num_grasps.

    Args:
        assessed: poses that went through everything.
        probe: of the gripper, for its symmetry.
        request: number of grasps; whether those that fail are wanted too.
        settings: duplicates.
        left_out: all drawn poses as they were before the restarts, and the indices of those that
            went no further.

    Returns:
        Grasps, and the number of drawn poses per reason. Returned grasps that pass and all counts
        make the number of poses.
    """
    check, score = assessed.check, assessed.score
    passing = np.flatnonzero(check.passed)
    repeats = suppress_duplicates(
        assessed.poses.tcp[passing], score[passing], probe.symmetry, settings.rank
    )
    check.reason[passing[repeats]] = "duplicate"
    good = _in_order(assessed, passing[~repeats], request)
    check.reason[good[request.num_grasps :]] = "surplus"
    grasps = [_grasp(assessed, i) for i in good[: request.num_grasps]]
    failed = [(assessed, np.flatnonzero(check.reason != ""))]
    reasons = check.reason
    if left_out is not None:
        others, index = left_out
        others.check.reason[index[others.check.reason[index] == ""]] = "unrefined"
        reasons = np.concatenate([reasons, others.check.reason[index]])
        failed.append(left_out)
    if request.keep_all:
        for source, index in failed:
            room = request.num_grasps - len(grasps)
            grasps += [_grasp(source, i) for i in _better_first(source, index)[:room]]
    return grasps, rejection_counts(reasons)


def _in_order(assessed: Assessment, rows: np.ndarray, request: SynthesisRequest) -> np.ndarray:
    """Rows in the order that the request prefers."""
    score = assessed.score[rows]
    if request.prefer == "high":
        height = assessed.poses.tcp[rows, :3, 3] @ -np.asarray(request.gravity)
        layer = np.floor((height.max(initial=0.0) - height) / LAYER)
        return rows[np.lexsort((-score, layer))]
    if request.prefer == "clear":
        return rows[np.lexsort((-score, -assessed.check.clearance[rows]))]
    return rows[np.argsort(-score, kind="stable")]


def _better_first(assessed: Assessment, index: np.ndarray) -> np.ndarray:
    """Repeats of a good grasp and poses that nobody had room for, or that were not refined, then
    those that fail, each by score.
    """
    failing = ~np.isin(assessed.check.reason[index], (*PASSED, "unrefined"))
    return index[np.lexsort((-assessed.score[index], failing))]


def _grasp(assessed: Assessment, i: int) -> RankedGrasp:
    poses, check = assessed.poses, assessed.check
    contacts, confidence = assessed.contacts, assessed.confidence
    reason = str(check.reason[i])
    return RankedGrasp(
        world_from_tcp=poses.tcp[i],
        world_from_gripper=poses.gripper[i],
        world_from_gripper_approach=poses.approach[i],
        world_from_gripper_retreat=poses.retreat[i],
        score=float(assessed.score[i]),
        width=float("nan") if contacts is None else float(contacts.width[i]),
        clearance=float(check.clearance[i]),
        tilt=float(check.tilt[i]),
        collision_free=reason in PASSED,
        reason=reason,
        confidence=float("nan") if confidence is None else float(confidence[i]),
        hidden_share=float(check.hidden_share[i]),
        width_tolerance=float("nan") if contacts is None else float(contacts.tolerance[i]),
        opening=float(assessed.opening[i]),
        share=float(assessed.share[i]),
        object=int(assessed.object[i]) or None,
    )

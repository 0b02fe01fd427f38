"""Local search about the best samples: small moves that raise the score or clear a collision.

A sample is good to a few millimetres and degrees; a fingertip beside a flat object or between two
others has less room than that. The check and the confidence cost a fraction of the sampling, so
the best samples are moved at random, with steps that shrink, and the better pose is kept.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.ranking import RankSettings, suppress_duplicates

from .rows import with_rows
from .scene_judge import Assessment
from .settings import PolishSettings

__all__ = ["polish", "promises"]

REPAIRABLE = 3.0
"""What a collision costs in logits of the score, next to the logarithm of the points that hit."""

HOPELESS = 12.0
"""What any other reason against a grasp costs."""


def polish(
    samples: Assessment,
    assess: Callable[[np.ndarray, bool], Assessment],
    settings: PolishSettings,
    rng: np.random.Generator,
    symmetry: int = 1,
    rank: RankSettings | None = None,
) -> Assessment:
    """Replace the most promising samples by better poses near them.

    Args:
        samples: N poses.
        assess: assessment of TCP poses (n, 4, 4), with contacts measured or not.
        settings: see `PolishSettings`.
        rng: of the moves.
        symmetry: of the gripper, to tell near duplicates.
        rank: what counts as a duplicate.

    Returns:
        N poses, each as it was or one that promises more.
    """
    before = promises(samples)
    order = np.argsort(-before, kind="stable")
    repeats = suppress_duplicates(samples.poses.tcp, before, symmetry, rank)
    chosen = order[~repeats[order]][: settings.candidates]
    if not len(chosen) or not settings.rounds:
        return samples
    tcp, promise = samples.poses.tcp[chosen], before[chosen]
    contacts = samples.contacts
    centring = None if contacts is None else np.nan_to_num(contacts.offset[chosen])
    for number in range(settings.rounds):
        moves = _moves(len(chosen), settings, settings.shrink**number, rng)
        if number == 0 and centring is not None:
            moves[:, 0] = np.eye(4)
            moves[:, 0, 0, 3] = centring
        tried = tcp[:, None] @ moves
        gained = promises(assess(tried.reshape(-1, 4, 4), False)).reshape(moves.shape[:2])
        best = gained.argmax(axis=1)
        better = gained.max(axis=1) > promise
        tcp[better] = tried[np.arange(len(chosen)), best][better]
        promise[better] = gained.max(axis=1)[better]
    polished = assess(tcp, True)
    rows = np.flatnonzero(promises(polished) > before[chosen])
    return with_rows(samples, chosen[rows], polished, rows)


def promises(assessment: Assessment) -> np.ndarray:
    """Logit (N,) of the score, lowered by what a grasp that fails the check lacks to pass it."""
    check = assessment.check
    score = np.clip(assessment.score, 1e-6, 1 - 1e-6)
    logit = np.log(score) - np.log1p(-score)
    hits = check.inside + check.approach_inside + check.structure
    collides = check.reason == "collision"
    lack = np.where(collides, REPAIRABLE + np.log1p(hits), HOPELESS)
    return np.where(check.passed, logit, logit - lack)


def _moves(
    count: int, settings: PolishSettings, scale: float, rng: np.random.Generator
) -> np.ndarray:
    """Random moves (count, moves, 4, 4) in the TCP frame."""
    shape = (count, settings.moves)
    moves = np.tile(np.eye(4), (*shape, 1, 1))
    moves[..., :3, 3] = rng.normal(scale=scale * settings.distance, size=(*shape, 3))
    turns = rng.normal(scale=scale * settings.angle, size=(count * settings.moves, 3))
    moves[..., :3, :3] = Rotation.from_rotvec(turns).as_matrix().reshape(*shape, 3, 3)
    return moves

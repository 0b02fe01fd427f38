"""Local search about samples, on a landscape that is known."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.errors import InvalidRequestError
from megrasp_core.ranking import GraspCheck
from megrasp_core.synthesizer import Assessment, PolishSettings, PoseSet
from megrasp_core.synthesizer.polish import polish, promises

GOAL = np.array([0.1, -0.05, 0.2])
WALL = 0.104
"""Poses whose x is beyond this collide."""


def assess(tcp: np.ndarray, contacts: bool) -> Assessment:
    """The score falls with the distance from GOAL; beyond WALL points hit."""
    n = len(tcp)
    beyond = np.clip(tcp[:, 0, 3] - WALL, 0.0, None)
    check = GraspCheck(
        reason=np.where(beyond > 0, "collision", "").astype("<U12"),
        collision_depth=beyond,
        inside=np.ceil(1000 * beyond).astype(int),
        approach_inside=np.zeros(n, int),
        structure=np.zeros(n, int),
        unseen_share=np.zeros(n),
        hidden_share=np.zeros(n),
        clearance=np.zeros(n),
        tilt=np.zeros(n),
    )
    score = np.exp(-np.linalg.norm(tcp[:, :3, 3] - GOAL, axis=1) / 0.02)
    poses = PoseSet(*(tcp.copy() for _ in range(4)))
    nothing = np.zeros(n)
    return Assessment(poses, check, None, score, score, nothing, nothing, nothing)


def samples(count: int = 6, seed: int = 0) -> np.ndarray:
    tcp = np.tile(np.eye(4), (count, 1, 1))
    tcp[:, :3, 3] = GOAL + np.random.default_rng(seed).normal(scale=0.02, size=(count, 3))
    return tcp


def polished(tcp, **options):
    settings = PolishSettings(**{"candidates": 3, "rounds": 4, "moves": 8, **options})
    return polish(assess(tcp, True), assess, settings, np.random.default_rng(1))


def test_no_sample_gets_worse_and_the_best_get_better():
    tcp = samples()
    before = promises(assess(tcp, True))
    assessment = polished(tcp)
    after = promises(assessment)
    assert (after >= before - 1e-9).all()
    assert after.max() > before.max() + 0.3
    assert (after > before).sum() <= 3
    again = assess(assessment.poses.tcp, True)
    np.testing.assert_allclose(again.score, assessment.score)


def test_a_colliding_sample_is_moved_out():
    tcp = samples(1)
    tcp[0, :3, 3] = GOAL + np.array([0.008, 0.0, 0.0])
    assert assess(tcp, True).check.reason[0] == "collision"
    assert polished(tcp).check.passed[0]


def test_moves_are_rigid():
    rotation = polished(samples()).poses.tcp[:, :3, :3]
    np.testing.assert_allclose(
        rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (6, 1, 1)), atol=1e-12
    )


def test_nothing_is_done_without_candidates_or_rounds():
    tcp = samples()
    for options in ({"candidates": 0}, {"rounds": 0}):
        np.testing.assert_array_equal(polished(tcp, **options).poses.tcp, tcp)


def test_bad_settings_are_named():
    with pytest.raises(InvalidRequestError, match="moves 0"):
        PolishSettings(moves=0)

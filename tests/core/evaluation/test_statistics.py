"""Intervals against known values and their coverage."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.evaluation.statistics import cluster_bootstrap, roc_auc, wilson


def test_wilson_against_a_textbook_value():
    rate = wilson(8, 10)
    assert rate.rate == 0.8
    assert rate.ci95 == pytest.approx((0.4902, 0.9433), abs=1e-3)


def test_no_trials_is_no_rate():
    assert wilson(0, 0).to_json() == {"successes": 0, "trials": 0, "rate": None, "ci95": None}
    assert cluster_bootstrap([], []).rate is None


def test_extremes_stay_in_range():
    assert wilson(0, 20).ci95[0] == 0.0
    assert wilson(20, 20).ci95[1] == 1.0


def test_bootstrap_is_wider_where_scenes_differ():
    same = cluster_bootstrap([50] * 20, [100] * 20)
    apart = cluster_bootstrap([100, 0] * 10, [100] * 20)
    assert same.rate == apart.rate == 0.5
    width = [r.ci95[1] - r.ci95[0] for r in (same, apart)]
    assert width[0] < 0.05 < 0.3 < width[1]


@pytest.mark.parametrize(
    ("won", "tried", "like"),
    [
        ([5], [10], (0.5, 1)),  # one scene is one draw of luck
        ([10, 10], [10, 10], (1.0, 2)),
        ([0] * 50 + [0], [8] * 50 + [0], (0.0, 50)),  # nothing was tried in the last
        ([3, 6], [10, 20], (0.3, 30)),
    ],
)
def test_scenes_without_a_difference_leave_a_doubt(won, tried, like):
    share, trials = like
    low, high = cluster_bootstrap(won, tried).ci95
    z = 1.959964
    for end in (low, high):
        if 0.0 < end < 1.0:  # Wilson's ends are where the share is z standard errors off
            error = (end * (1 - end) / trials) ** 0.5
            assert abs(end - share) == pytest.approx(z * error, rel=1e-4)
    assert high - low > 0.05


def test_bootstrap_covers_the_truth():
    """Scenes with their own luck: about 95 % of the intervals hold the mean of all scenes."""
    rng = np.random.default_rng(0)
    held = 0
    for draw in range(200):
        luck = rng.beta(4, 2, 40)
        rate = cluster_bootstrap(rng.binomial(30, luck), [30] * 40, seed=draw, draws=600)
        held += rate.ci95[0] <= 4 / 6 <= rate.ci95[1]
    assert 0.88 <= held / 200 <= 0.99


def test_auc_against_a_count_of_pairs():
    score = np.array([0.9, 0.4, 0.4, 0.1])
    success = np.array([True, True, False, False])
    # Of the four pairs of success and failure three are in order and one is a tie.
    assert roc_auc(score, success) == 0.875
    assert roc_auc(score, np.ones(4, bool)) is None

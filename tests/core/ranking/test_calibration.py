"""The logistic calibration of the score."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from megrasp_core.errors import InvalidRequestError
from megrasp_core.ranking import Calibration, fit_calibration, logistic_features
from megrasp_core.ranking.calibration import FULL_CLEARANCES


def drawn(weights: Calibration, count: int, seed: int = 0):
    """Features and verdicts of grasps that succeed as `weights` say."""
    rng = np.random.default_rng(seed)
    features = logistic_features(
        rng.uniform(0.02, 0.98, count),
        rng.uniform(0.0, 0.6, count),
        np.where(rng.random(count) < 0.6, 0.0, rng.uniform(0.0, 0.02, count)),
        rng.uniform(0.0, 0.01, count),
    )
    return features, rng.random(count) < weights.of_features(features)


@pytest.mark.parametrize("full", FULL_CLEARANCES)
def test_the_fit_finds_the_weights_that_the_verdicts_were_drawn_with(full):
    truth = Calibration(0.4, 0.8, tilt=-3.0, hidden=-0.7, clearance=300.0, full_clearance=full)
    found = fit_calibration(*drawn(truth, 20_000))
    assert found.full_clearance == full
    assert found.confidence == pytest.approx(0.8, abs=0.06)
    assert found.tilt == pytest.approx(-3.0, abs=0.4)
    assert found.hidden == pytest.approx(-0.7, abs=0.08)
    assert found.clearance == pytest.approx(300.0, abs=50.0)
    assert found.bias == pytest.approx(0.4, abs=0.2)


def test_few_grasps_leave_the_confidence_nearly_as_it_is():
    features, success = drawn(Calibration(), 12)
    found = fit_calibration(features, success, penalty=1e4)
    assert found.confidence == pytest.approx(1.0, abs=0.05)
    assert abs(found.tilt) < 0.05 and abs(found.hidden) < 0.01


def test_chance_does_not_make_tilt_hidden_share_or_contact_an_advantage():
    odd = Calibration(bias=0.4, confidence=0.8, tilt=3.0, hidden=0.7, clearance=-90.0)
    found = fit_calibration(*drawn(odd, 2000))
    assert found.tilt == found.hidden == found.clearance == 0.0
    assert found.confidence == pytest.approx(0.8, abs=0.2)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_default_is_the_confidence_itself(confidence, tilt):
    features = logistic_features(
        np.array([confidence]), np.array([tilt]), np.zeros(1), np.zeros(1)
    )
    assert Calibration().of_features(features)[0] == pytest.approx(confidence, abs=2e-4)


def test_unknown_gravity_does_not_spread():
    features = logistic_features(np.array([0.5]), np.array([np.nan]), np.zeros(1), np.zeros(1))
    assert np.isfinite(features).all()


def test_one_sided_verdicts_are_refused():
    features, _ = drawn(Calibration(), 10)
    with pytest.raises(InvalidRequestError, match="10 successes of 10"):
        fit_calibration(features, np.ones(10, bool))

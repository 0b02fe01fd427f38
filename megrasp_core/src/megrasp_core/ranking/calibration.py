"""Probability of success from the model's confidence and from what the check measured."""

from __future__ import annotations

import dataclasses

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .check import GraspCheck

__all__ = ["FEATURES", "Calibration", "fit_calibration", "logistic_features"]

FEATURES = ("confidence", "tilt", "hidden", "clearance")
FULL_CLEARANCES = (0.003, 0.006, 0.01)
"""Of these a fit takes what explains the verdicts best (m): jaws go by the first millimetres, a
hand that has more room sits better on what it takes.
"""

UNKNOWN_TILT = 0.3
"""Taken where gravity is not known (rad)."""

LOGIT_LIMIT = 9.0


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Logistic model of the verdict, fitted to a model's own grasps in simulation.

    p = 1 / (1 + exp(-z)), z = bias + confidence logit(c) + tilt t + hidden log(1 + 1000 h)
                               + clearance min(d, full_clearance)

    with c the model's confidence, t the tilt (rad), h the share of the gripper that lies where
    nothing was seen, d the clearance (m), of which more than `full_clearance` makes a grasp no
    better. The default takes the confidence as it is.
    """

    bias: float = 0.0
    confidence: float = 1.0
    tilt: float = 0.0
    hidden: float = 0.0
    clearance: float = 0.0
    full_clearance: float = FULL_CLEARANCES[0]

    def probability(self, check: GraspCheck, confidence: np.ndarray) -> np.ndarray:
        """Probability (N,) that the verdict on checked grasps is success.

        Args:
            check: of N grasps.
            confidence: (N,) of the same, 0..1.
        """
        return self.of_features(
            logistic_features(confidence, check.tilt, check.hidden_share, check.clearance)
        )

    def of_features(self, features: np.ndarray) -> np.ndarray:
        """Probability (N,) for `logistic_features` (N, 4)."""
        return 1.0 / (1.0 + np.exp(-self.terms(features).sum(axis=1)))

    def terms(self, features: np.ndarray) -> np.ndarray:
        """What z is the sum of (N, 5): the bias, and what each of the `FEATURES` adds."""
        weights = np.array([self.bias, *(getattr(self, name) for name in FEATURES)])
        return _with_bias(features, self.full_clearance) * weights

    def to_dict(self) -> dict[str, float]:
        """Plain values for config.json."""
        return {key: round(value, 4) for key, value in dataclasses.asdict(self).items()}


def logistic_features(
    confidence: np.ndarray, tilt: np.ndarray, hidden_share: np.ndarray, clearance: np.ndarray
) -> np.ndarray:
    """Inputs (N, 4) of the logistic model, in the order of `FEATURES`.

    Args:
        confidence: (N,) 0..1.
        tilt: (N,) rad; NaN where gravity is not known.
        hidden_share: (N,) 0..1.
        clearance: (N,) m.
    """
    c = np.clip(np.asarray(confidence, dtype=np.float64), 0.0, 1.0)
    with np.errstate(divide="ignore"):
        logit = np.clip(np.log(c) - np.log1p(-c), -LOGIT_LIMIT, LOGIT_LIMIT)
    tilt = np.nan_to_num(tilt, nan=UNKNOWN_TILT)
    return np.stack([logit, tilt, np.log1p(1000 * hidden_share), clearance], axis=1).astype(
        np.float64
    )


def fit_calibration(
    features: np.ndarray, success: np.ndarray, *, penalty: float = 1.0
) -> Calibration:
    """Fit by maximum likelihood with a ridge towards the plain confidence.

    Confidence and clearance never lower the probability, tilt and hidden share never raise it:
    where a fit to few grasps says otherwise, it is chance. Of `FULL_CLEARANCES` it takes the one
    under which the verdicts are likeliest.

    Args:
        features: (N, 4), see `logistic_features`.
        success: (N,) bool.
        penalty: of the squared weights in units of a typical spread of the features.

    Raises:
        InvalidRequestError: only successes or only failures were given.
    """
    y = np.asarray(success, dtype=np.float64)
    if y.min(initial=1.0) == y.max(initial=0.0):
        raise InvalidRequestError(
            f"{int(y.sum())} successes of {len(y)} grasps were given; expected both successes and "
            "failures. Judge more grasps."
        )
    fits = [_fit(_with_bias(features, full), y, penalty) for full in FULL_CLEARANCES]
    best = min(range(len(fits)), key=lambda k: fits[k][0])
    bias, *weights = fits[best][1].tolist()
    return Calibration(bias, *weights, full_clearance=FULL_CLEARANCES[best])


def _with_bias(features: np.ndarray, full_clearance: float) -> np.ndarray:
    x = np.column_stack([np.ones(len(features)), features])
    x[:, -1] = np.minimum(x[:, -1], full_clearance)
    return x


def _fit(x: np.ndarray, y: np.ndarray, penalty: float) -> tuple[float, np.ndarray]:
    """Loss and weights (5,), the bias first."""
    # Whoever only ranks has no use for it, and it takes a quarter of a second.
    from scipy.optimize import minimize

    scale = np.array([1.0, 1.0, 0.2, 1.0, 0.002])
    x = x / scale
    prior = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
    strength = penalty * np.array([0.0, 1.0, 1.0, 1.0, 1.0])

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        z = x @ w
        p = 1.0 / (1.0 + np.exp(-z))
        value = np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * np.sum(strength * (w - prior) ** 2)
        return float(value), x.T @ (p - y) + strength * (w - prior)

    bounds = [(None, None), (0.0, None), (None, 0.0), (None, 0.0), (0.0, None)]
    found = minimize(loss, prior, jac=True, method="L-BFGS-B", bounds=bounds)
    return float(found.fun), found.x / scale

"""What more training would bring: a power law through a run's validation losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import curve_fit

from megrasp_core.errors import InvalidRequestError

__all__ = ["LossCurve", "fit_curve"]

MINIMUM = 8
"""Fewer losses than this are not extrapolated."""


@dataclass(frozen=True, slots=True)
class LossCurve:
    """loss(n) = limit + gain n^-exponent, n in millions of poses.

    Attributes:
        limit: loss that no amount of training goes below.
        gain: what the limit lacks at a million poses.
        exponent: how fast the rest falls.
        covariance: (3, 3) of the three in this order.
        residual: root mean square of the losses that were fitted.
    """

    limit: float
    gain: float
    exponent: float
    covariance: np.ndarray
    residual: float

    def at(self, poses: float) -> float:
        """Loss after so many poses."""
        return float(_law(poses / 1e6, self.limit, self.gain, self.exponent))

    def error(self, poses: float) -> float:
        """Standard error of `at` from that of the fit; it does not know whether the law holds."""
        n = poses / 1e6
        fallen = n**-self.exponent
        slope = np.array([1.0, fallen, -self.gain * fallen * np.log(n)])
        return float(np.sqrt(slope @ self.covariance @ slope))


def fit_curve(
    lines: Sequence[Mapping[str, Any]], first: float = 0.0, last: float = np.inf
) -> LossCurve:
    """Fit the diffusion's validation losses of a run by least squares.

    Args:
        lines: of `losses.jsonl` (`read_losses`).
        first: poses from which losses count; a run's start follows no power law.
        last: poses up to which they count.

    Raises:
        InvalidRequestError: fewer than `MINIMUM` losses between the two.
    """
    points = [
        (line["poses"] / 1e6, line["validation_diffusion"])
        for line in lines
        if line.get("validation_diffusion") is not None and first <= line["poses"] <= last
    ]
    if len(points) < MINIMUM:
        raise InvalidRequestError(
            f"{len(points)} validation losses between {first:g} and {last:g} poses; expected at "
            f"least {MINIMUM}: train on, or count from fewer poses."
        )
    n, loss = np.array(points).T
    start = (0.9 * loss.min(), loss.max() - 0.9 * loss.min(), 0.5)
    found, covariance = curve_fit(_law, n, loss, p0=start, bounds=(0.0, np.inf))
    residual = float(np.sqrt(np.mean((loss - _law(n, *found)) ** 2)))
    limit, gain, exponent = map(float, found)
    return LossCurve(limit, gain, exponent, covariance, residual)


def _law(n: Any, limit: float, gain: float, exponent: float) -> Any:
    return limit + gain * n**-exponent

"""Rates with intervals (docs/architecture.md, "Rates").

Samples of one scene share its luck, so their rate gets a cluster bootstrap over scenes; first
grasps are nearly independent attempts and get Wilson's interval. Where drawing scenes again
changes nothing, because there is one or all have the same rate, the bootstrap knows of no doubt,
and Wilson's interval of the effective number of trials takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

SAME = 1e-9
"""Rates that differ by less are the same."""


@dataclass(frozen=True)
class Rate:
    """Successes out of trials with a 95 % interval; rate and interval are None without trials."""

    successes: int
    trials: int
    ci95: tuple[float, float] | None

    @property
    def rate(self) -> float | None:
        """Share of successes."""
        return self.successes / self.trials if self.trials else None

    def to_json(self) -> dict[str, Any]:
        """Entry of a result file."""
        return {
            "successes": self.successes,
            "trials": self.trials,
            "rate": None if self.rate is None else round(self.rate, 4),
            "ci95": None if self.ci95 is None else [round(v, 4) for v in self.ci95],
        }


def wilson(successes: int, trials: int, level: float = 0.95) -> Rate:
    """Wilson's score interval of a binomial share."""
    if not trials:
        return Rate(0, 0, None)
    return Rate(successes, trials, _wilson_interval(successes / trials, trials, level))


def _wilson_interval(share: float, trials: float, level: float) -> tuple[float, float]:
    z = float(norm.ppf(0.5 + level / 2))
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = (
        z
        / (1 + z * z / trials)
        * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials**2))
    )
    return max(0.0, middle - half), min(1.0, middle + half)


def cluster_bootstrap(
    successes: Sequence[int],
    trials: Sequence[int],
    *,
    seed: int = 0,
    draws: int = 4000,
    level: float = 0.95,
) -> Rate:
    """Percentile interval of the pooled rate when whole scenes are drawn again.

    Where that has no width it is Wilson's: of as many trials as there are scenes, as if all of a
    scene were one attempt, where there is one scene or no sample, or every one, succeeded; of all
    trials where several scenes have the same rate in between, since samples of a scene are then
    no more alike than those of two.

    Args:
        successes: per scene.
        trials: per scene.
        seed: of the bootstrap.
        draws: bootstrap samples.
        level: of the interval.
    """
    won, tried = np.asarray(successes, int), np.asarray(trials, int)
    if not tried.sum():
        return Rate(0, 0, None)
    index = np.random.default_rng(seed).integers(len(tried), size=(draws, len(tried)))
    totals = tried[index].sum(1)
    rates = won[index].sum(1)[totals > 0] / totals[totals > 0]
    low, high = np.quantile(rates, [0.5 - level / 2, 0.5 + level / 2])
    if high - low < SAME:
        share, scenes = won.sum() / tried.sum(), int((tried > 0).sum())
        alike = scenes == 1 or share in (0, 1)
        low, high = _wilson_interval(share, scenes if alike else int(tried.sum()), level)
    return Rate(int(won.sum()), int(tried.sum()), (float(low), float(high)))


def roc_auc(score: NDArray[np.float64], success: NDArray[np.bool_]) -> float | None:
    """Area under the ROC curve: how often a success has the higher score than a failure.

    Args:
        score: (N,).
        success: (N,).

    Returns:
        0..1, ties count half; None without successes or without failures.
    """
    won = int(success.sum())
    lost = len(success) - won
    if not won or not lost:
        return None
    ranks = rankdata(score)[success].sum()
    return round(float((ranks - won * (won + 1) / 2) / (won * lost)), 4)

"""Poses that were drawn at once, from where they began to what is known of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .rows import joined, with_rows
from .scene_judge import Assessment

__all__ = ["Draw"]


@dataclass(frozen=True)
class Draw:
    """N poses.

    Attributes:
        starts: (N, 3) points from which they were drawn, before the noise (m).
        sampled: (N, 4, 4) TCP poses where the sampler left them.
        final: assessment of those that went through everything, in their order.
        left_out: assessment of all N before the restarts, and the indices of those that went no
            further; None: all went.
    """

    starts: NDArray[np.float64]
    sampled: NDArray[np.float64]
    final: Assessment
    left_out: tuple[Assessment, NDArray[np.int64]] | None

    @property
    def best_score(self) -> float:
        """Of those that pass the check; 0 where none does."""
        return float(self.final.score[self.final.check.passed].max(initial=0.0))

    @property
    def assessment(self) -> Assessment:
        """Of all N, each as far as it went."""
        if self.left_out is None:
            return self.final
        first, index = self.left_out
        kept = np.setdiff1d(np.arange(len(self.starts)), index)
        return with_rows(first, kept, self.final, np.arange(len(kept)))

    @classmethod
    def of(cls, draws: Sequence[Draw]) -> Draw:
        """All poses of several draws as one."""
        if len(draws) == 1:
            return draws[0]
        counts = [len(draw.starts) for draw in draws]
        first = np.cumsum([0, *counts[:-1]])
        left_out = [draw.left_out for draw in draws if draw.left_out is not None]
        return cls(
            np.concatenate([draw.starts for draw in draws]),
            np.concatenate([draw.sampled for draw in draws]),
            joined([draw.final for draw in draws]),
            (
                joined([assessed for assessed, _ in left_out]),
                np.concatenate([i + at for (_, i), at in zip(left_out, first, strict=True)]),
            )
            if left_out
            else None,
        )

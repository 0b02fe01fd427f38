"""Noise levels of the diffusion on SE(3). See docs/architecture.md, "Diffusion"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError
from megrasp_core.ranges import POSITIVE, Range, check_ranges

LOW_LEVEL = 0.1
"""Below this level of noise a pose is a matter of millimetres."""


class NoiseSizes(Protocol):
    """What a schedule takes from the config of a network."""

    @property
    def sigma_t(self) -> float: ...
    @property
    def sigma_r(self) -> float: ...
    @property
    def s_min(self) -> float: ...


@dataclass(frozen=True)
class NoiseSchedule:
    """How much noise a level s in [s_min, 1] stands for: s sigma_t metres and s sigma_r radians.

    Attributes:
        sigma_t: standard deviation of the translation noise per axis at s = 1 (m).
        sigma_r: scale of the rotation noise at s = 1 (rad); at 2.0 uniform rotations are a correct
            start.
        s_min: the lowest level that the network sees.
    """

    sigma_t: float = 0.08
    sigma_r: float = 2.0
    s_min: float = 0.03

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InvalidRequestError: a value is outside its range.
        """
        check_ranges(
            self,
            sigma_t=POSITIVE,
            sigma_r=POSITIVE,
            s_min=Range(above=0, below=1),
        )

    @classmethod
    def of(cls, config: NoiseSizes) -> NoiseSchedule:
        """The schedule that a network was made for."""
        return cls(config.sigma_t, config.sigma_r, config.s_min)

    def levels(self, count: int, start: float = 1.0) -> list[float]:
        """The `count` levels at which the network is evaluated, falling from `start`, then 0.

        Geometric down to s_min, s_k = start (s_min/start)^((k-1)/(count-1)). A single evaluation
        goes from `start` to 0.

        Returns:
            count + 1 numbers, the last one 0.

        Raises:
            InvalidRequestError: count below 1, or start outside (s_min, 1].
        """
        if count < 1 or not self.s_min < start <= 1:
            raise InvalidRequestError(
                f"got {count} steps from level {start}; expected at least one step and a level "
                f"over {self.s_min} and up to 1"
            )
        if count == 1:
            return [start, 0.0]
        ratio = self.s_min / start
        return [start * ratio ** (k / (count - 1)) for k in range(count)] + [0.0]

    def random_levels(
        self,
        count: int,
        generator: torch.Generator | None = None,
        *,
        low_share: float | None = None,
        device: torch.device | str = "cpu",
    ) -> Tensor:
        """Levels (count,) for training, stratified: log s uniform in [log s_min, 0], or uniform in
        both parts with a share of the levels below `LOW_LEVEL`.
        """
        jitter = torch.rand(count, generator=generator, device=device)
        uniform = (torch.arange(count, device=device) + jitter) / count
        lowest = math.log(self.s_min)
        if low_share is None or self.s_min >= LOW_LEVEL:
            return torch.exp(lowest * uniform)
        border, high = math.log(LOW_LEVEL), 1.0 - low_share
        above = border * uniform / high
        below = border + (lowest - border) * (uniform - high) / max(low_share, 1e-9)
        return torch.exp(torch.where(uniform < high, above, below))

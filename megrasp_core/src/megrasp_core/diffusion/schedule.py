"""Noise levels of the diffusion on SE(3). DESIGN section 6."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError

Process = Literal["diffusion", "flow"]


@dataclass(frozen=True)
class NoiseSchedule:
    """How much noise a level s in [s_min, 1] stands for: s sigma_t metres and s sigma_r radians.

    Attributes:
        sigma_t: standard deviation of the translation noise per axis at s = 1 (m).
        sigma_r: scale of the rotation noise at s = 1 (rad); at 2.0 uniform rotations are a correct
            start.
        s_min: the lowest level that the network sees.
        process: "diffusion" (isotropic Gaussian on SO(3)) or "flow" (geodesic flow matching
            towards a uniform rotation; levels in training are then uniform in s instead of in log
            s).
    """

    sigma_t: float = 0.08
    sigma_r: float = 2.0
    s_min: float = 0.03
    process: Process = "diffusion"

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InvalidRequestError: a value is outside its range.
        """
        if not (self.sigma_t > 0 and self.sigma_r > 0 and 0 < self.s_min < 1):
            raise InvalidRequestError(
                f"got sigma_t={self.sigma_t}, sigma_r={self.sigma_r}, s_min={self.s_min}; "
                "expected positive sigmas and s_min between 0 and 1"
            )
        if self.process not in ("diffusion", "flow"):
            raise InvalidRequestError(
                f"got process {self.process!r}; expected 'diffusion' or 'flow'"
            )

    def levels(self, count: int, start: float = 1.0) -> list[float]:
        """The `count` levels at which the network is evaluated, falling from `start`, then 0.

        Diffusion: geometric down to s_min, s_k = start (s_min/start)^((k-1)/(count-1)); flow:
        equal steps. A single evaluation goes from `start` to 0.

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
        if self.process == "flow":
            return [start * (1 - k / count) for k in range(count)] + [0.0]
        if count == 1:
            return [start, 0.0]
        ratio = self.s_min / start
        return [start * ratio ** (k / (count - 1)) for k in range(count)] + [0.0]

    def random_levels(
        self,
        *shape: int,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
    ) -> Tensor:
        """Levels (*shape) for training: log s (diffusion) or s (flow) uniform over [s_min, 1]."""
        u = torch.rand(*shape, generator=generator, dtype=dtype, device=device)
        if self.process == "flow":
            return self.s_min + (1 - self.s_min) * u
        return torch.exp(math.log(self.s_min) * u)

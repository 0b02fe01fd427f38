"""What a caller can choose about sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from megrasp_core.errors import InvalidRequestError
from megrasp_core.ranges import COUNT, FROM_ONE, Range, check_ranges

from .schedule import NoiseSchedule

Kind = Literal["ancestral", "deterministic", "langevin", "probability_flow"]
KINDS: tuple[Kind, ...] = (
    "ancestral",
    "deterministic",
    "langevin",
    "probability_flow",
)


@dataclass(frozen=True)
class SamplerSettings:
    """Sampler and its evaluations of the network. See docs/architecture.md, "Diffusion".

    Attributes:
        kind: `ancestral` (default, stochastic) and `deterministic` use the residual; `langevin`
            and `probability_flow` need the rotation score head.
        steps: noise levels from s = 1; network evaluations of the first descent, except for
            langevin.
        restarts: how often the result gets noise again and descends again.
        restart_level: s of that noise.
        restart_steps: evaluations of one restart.
        langevin_inner: network evaluations per level.
        langevin_step: size of a move: its noise variance is this share of the level's variance.
        langevin_predictor: the last evaluation of a level goes down to the next one by the reverse
            process (predictor-corrector); without, levels are only annealed, as in Diffusion-EDF,
            and modes that part at a high level keep too equal shares.
    """

    kind: Kind = "ancestral"
    steps: int = 10
    restarts: int = 2
    restart_level: float = 0.3
    restart_steps: int = 5
    langevin_inner: int = 20
    langevin_step: float = 0.2
    langevin_predictor: bool = True

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InvalidRequestError: a value is outside its range.
        """
        if self.kind not in KINDS:
            raise InvalidRequestError(
                f"got sampler {self.kind!r}; expected one of {', '.join(KINDS)}"
            )
        check_ranges(
            self,
            steps=FROM_ONE,
            restarts=COUNT,
            restart_level=Range(high=1, above=0),
            restart_steps=FROM_ONE,
            langevin_inner=FROM_ONE,
            langevin_step=Range(above=0, below=2),
        )

    @property
    def uses_score(self) -> bool:
        """Whether the rotation part handed to the sampler must be the score head's."""
        return self.kind in ("langevin", "probability_flow")

    @property
    def descend_evaluations(self) -> int:
        """Network evaluations per pose before the restarts."""
        return self._evaluations(self.steps)

    @property
    def refine_evaluations(self) -> int:
        """Network evaluations per pose in all restarts."""
        return self.restarts * self._evaluations(self.restart_steps)

    @property
    def evaluations(self) -> int:
        """Network evaluations per pose that goes through everything (default 20)."""
        return self.descend_evaluations + self.refine_evaluations

    def _evaluations(self, steps: int) -> int:
        if self.kind != "langevin":
            return steps
        # Without the predictor one more evaluation takes the noise of the last level off.
        return steps * self.langevin_inner + (0 if self.langevin_predictor else 1)

    def check(self, schedule: NoiseSchedule) -> None:
        """Check that the sampler fits the process that the network was trained with.

        Raises:
            InvalidRequestError: restarts from below the lowest level.
        """
        if self.restarts > 0 and self.restart_level <= schedule.s_min:
            raise InvalidRequestError(
                f"got restart_level={self.restart_level}; expected a level over the lowest one, "
                f"{schedule.s_min}, or restarts=0"
            )

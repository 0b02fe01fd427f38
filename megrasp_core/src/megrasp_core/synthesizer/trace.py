"""What a synthesis did on the way to its answer, for whoever has to explain it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.ranking import GripperProbe, SceneObservation

from .request import SynthesisRequest
from .scene_judge import Assessment

__all__ = ["OnTrace", "Trace"]


@dataclass(frozen=True, eq=False)
class Trace:
    """One synthesis of N drawn poses, all in the frame of the cloud minus `offset`.

    Attributes:
        request: what was asked for.
        observation: what was seen, with walls and floor.
        probe: of the gripper.
        starts: (N, 3) points from which the poses were drawn, before the noise (m).
        drawn: (N, 4, 4) TCP poses where the sampler left them, before any of them was turned over,
            moved back or polished.
        assessment: of the N poses as they were ranked, each with the reason why it was not
            returned, "" where it was; None where nothing was drawn.
        offset: (3,) that brings these coordinates to those of the cloud as it was given (m); not
            zero for clouds far from their origin.
    """

    request: SynthesisRequest
    observation: SceneObservation
    probe: GripperProbe
    starts: NDArray[np.float64]
    drawn: NDArray[np.float64]
    assessment: Assessment | None
    offset: NDArray[np.float64]


OnTrace = Callable[[Trace], None]

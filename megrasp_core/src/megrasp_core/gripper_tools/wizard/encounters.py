"""Fingers that run into each other before the closed posture."""

from __future__ import annotations

import itertools

import numpy as np

from .analyse import Analysis
from .fingers import Finger
from .gaps import Gaps
from .prepare import Prepared

STEPS = 12
DEEP = 0.002
"""Fingers that overlap less (m) touch."""


def collisions_on_the_way(prepared: Prepared, analysis: Analysis) -> list[str]:
    """Return a line for every two fingers of which one blocks the other between the open and the
    closed posture.

    Pads that meet at the end of the way are what closing is for; fingers that overlap at the start
    overlap by the way they are drawn.
    """
    motion, opposition = prepared.motion, analysis.opposition
    gaps = Gaps(prepared.model)
    out = []
    for first, second in itertools.combinations(analysis.fingers, 2):
        bodies = _moving(prepared, first), _moving(prepared, second)

        def gap(time: float, bodies: tuple[list[int], list[int]] = bodies) -> float:
            lengths = opposition.open + time * (opposition.closed - opposition.open)
            return gaps.distance(motion.qpos(lengths), *bodies)

        if gap(0.0) < 0.0:
            continue
        times = np.linspace(0.0, 1.0, STEPS + 1)[1:]
        met = next((float(time) for time in times if gap(float(time)) < -DEEP), None)
        if met is not None:
            out.append(
                f"finger '{first.name}' runs into finger '{second.name}' after "
                f"{100.0 * met:.0f} % of the way to the closed posture, which is not reached so: "
                "say where they stop with --closed"
            )
    return out


def _moving(prepared: Prepared, finger: Finger) -> list[int]:
    return [body for body in finger.links if (prepared.mechanism.owner == body).any()]

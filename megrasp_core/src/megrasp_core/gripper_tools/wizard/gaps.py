"""Distance between links in a posture, from the exact shapes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import COLLISION_GROUP

FAR = 1.0
STEPS = 40
BISECTIONS = 12
TOUCHING = 2e-4


class Gaps:
    """Distances between bodies of a model (mesh geoms as convex hulls), metres."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        self._geoms: dict[int, list[int]] = {}
        for body in range(model.nbody):
            own = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) == body]
            solid = [g for g in own if model.geom_group[g] == COLLISION_GROUP]
            self._geoms[body] = solid or own

    def distance(
        self, qpos: NDArray[np.float64], first: Sequence[int], second: Sequence[int]
    ) -> float:
        """Return the smallest distance between two sets of bodies at joint positions (nq,);
        negative where they overlap.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        best = FAR
        for a in self._of(first):
            for b in self._of(second):
                best = min(best, mujoco.mj_geomDistance(self._model, self._data, a, b, best, None))
        return best

    def _of(self, bodies: Sequence[int]) -> list[int]:
        return [geom for body in bodies for geom in self._geoms[body]]


def first_contact(gap: Callable[[float], float]) -> tuple[float, bool]:
    """Return the first t in [0, 1] at which `gap` falls to 0, and whether it does.

    Without a contact t is where the gap is smallest.
    """
    times = np.linspace(0.0, 1.0, STEPS + 1)
    values = [gap(0.0)]
    for before, after in itertools.pairwise(times.tolist()):
        values.append(gap(after))
        if values[-1] > TOUCHING:
            continue
        low, high = before, after
        for _ in range(BISECTIONS):
            half = (low + high) / 2.0
            low, high = (low, half) if gap(half) <= TOUCHING else (half, high)
        return high, True
    return float(times[int(np.argmin(values))]), False

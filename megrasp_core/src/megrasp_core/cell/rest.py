"""How the objects of a cell come to rest, at the start and after every attempt."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import SimulationError
from megrasp_core.objects import ObjectModel
from megrasp_core.simulation import Bin, World, settle

SETTLE_ATTEMPTS = 4

REST_SPEED = (0.02, 0.3)
"""Objects slower than this (m/s, rad/s) for `REST_TIME` (s) are at rest."""

REST_TIME = 0.2
REST_LIMIT = 4.0
"""Longest wait for rest (s)."""


def settle_all(
    objects: Sequence[ObjectModel], bin: Bin, seed: int, *, friction: float | None
) -> NDArray[np.float64]:
    """Poses world_from_object (n, 4, 4) of all objects, fallen into the bin and at rest.

    Raises SimulationError if some leave the bin or do not come to rest in several attempts.
    """
    for attempt in range(SETTLE_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt, 0])
        scene = settle(objects, bin=bin, rng=rng, friction=friction)
        if scene.ok and len(scene.kept) == len(objects):
            return scene.object_poses
    raise SimulationError(
        f"{len(objects)} objects did not come to rest in the bin in {SETTLE_ATTEMPTS} attempts "
        f"from seed {seed}; use fewer or smaller objects, or another seed"
    )


def come_to_rest(world: World) -> None:
    """Runs the physics until the objects are at rest; SimulationError if it diverges."""
    step = 0.05
    calm = elapsed = 0.0
    while calm < REST_TIME and elapsed < REST_LIMIT:
        mujoco.mj_step(world.model, world.data, nstep=round(step / world.model.opt.timestep))
        elapsed += step
        calm = calm + step if (world.object_speeds() < REST_SPEED).all() else 0.0
    if world.unstable():
        raise SimulationError(
            "the physics diverged while the objects came to rest; try another grasp or another "
            "seed"
        )


def outside_bin(world: World) -> list[int]:
    """Objects whose centre is beyond the bin's outer edges; what lies on the rim is inside."""
    assert world.bin is not None
    half = np.asarray(world.bin.inner[:2]) / 2.0 + world.bin.wall
    centres = (np.linalg.inv(world.bin.world_from_bin) @ world.object_poses())[:, :2, 3]
    return [i for i in world.present if (np.abs(centres[i]) > half).any()]

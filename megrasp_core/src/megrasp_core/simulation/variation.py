"""Other physics for one trial: friction of the gripper's contacts, mass of the objects, force of
the drives.

What varies is what a robot does not know of the grasp. How the heap lies it has seen, so the heap
must not slide for it: friction changes where the gripper touches and nowhere else, and all objects
become heavier or lighter alike, which leaves the balance of a heap at rest as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import SimulationError
from megrasp_core.ranges import Range, check_ranges

from .world import GRIPPER, World

TORSIONAL, ROLLING = 0.01, 0.0001
"""Friction of the gripper's contacts besides the sliding one, which all
objects have by default.
"""

_Array = NDArray[Any]
_Keep = Callable[[_Array], _Array]
"""Remembers an array of the model before it is changed, and returns it."""


@dataclass(frozen=True)
class Variation:
    """How a trial differs from the plain one; None leaves as it is.

    Attributes:
        friction: sliding friction of the gripper with whatever it touches.
        mass: factor on the mass and inertia of all objects.
        force: factor on the force that the gripper's drives give in the same state, and on its
            limits.
    """

    friction: float | None = None
    mass: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        check_ranges(
            self,
            SimulationError,
            friction=Range(above=0, optional=True),
            mass=Range(above=0, optional=True),
            force=Range(above=0, optional=True),
        )


@contextmanager
def varied(world: World, variation: Variation) -> Iterator[None]:
    """Changes the compiled model of a world, and leaves it bit for bit as it was.

    The state of the world is not touched. A world saved before can be restored within.

    Raises:
        SimulationError: the force shall vary, and there is no gripper, or one whose drives are
            neither motors nor position drives.
    """
    model = world.model
    kept: list[tuple[_Array, _Array]] = []

    def keep(array: _Array) -> _Array:
        kept.append((array, array.copy()))
        return array

    try:
        if variation.friction is not None:
            geoms = world.owner == GRIPPER
            # A geom of higher priority alone decides on the friction of a contact; without it the
            # higher friction of the two would, and nothing could become smoother.
            keep(model.geom_priority)[geoms] = 1
            keep(model.geom_friction)[geoms] = (variation.friction, TORSIONAL, ROLLING)
        if variation.mass is not None:
            _scale_objects(world, variation.mass, keep)
        if variation.force is not None:
            _scale_drives(world, variation.force, keep)
        yield
    finally:
        for array, values in reversed(kept):
            array[...] = values


def _scale_objects(world: World, factor: float, keep: _Keep) -> None:
    """As compiling with other masses would: what MuJoCo derives from them is scaled too."""
    model = world.model
    bodies, dofs = world.object_bodies, world.object_dofs.ravel()
    before = model.body_mass[bodies].sum()
    for array in (model.body_mass, model.body_inertia, model.body_subtreemass):
        keep(array)[bodies] *= factor
    model.body_subtreemass[0] += (factor - 1.0) * before
    # Where these stayed, contacts of heavier objects would be softer.
    for array, index in (
        (model.body_invweight0, bodies),
        (model.dof_invweight0, dofs),
    ):
        keep(array)[index] /= factor
    keep(model.dof_M0)[dofs] *= factor


def _scale_drives(world: World, factor: float, keep: _Keep) -> None:
    """Gains and limits alike: at the same joint positions, speeds and controls a drive gives
    `factor` times the force, whether or not it is at its limit.
    """
    model = world.model
    gripper = world.hand.gripper
    gains = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
    biases = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    if not (
        np.isin(model.actuator_gaintype, gains).all()
        and np.isin(model.actuator_biastype, biases).all()
    ):
        raise SimulationError(
            f"gripper {gripper.name!r} has drives whose force does not grow with their "
            "gain, such as muscles; expected motors or position drives. Name the joints in "
            "'actuation' of its description."
        )
    keep(model.actuator_gainprm)[:, :3] *= factor
    keep(model.actuator_biasprm)[:, :3] *= factor
    keep(model.actuator_forcerange)[:] *= factor
    keep(model.jnt_actfrcrange)[:] *= factor
    keep(model.tendon_actfrcrange)[:] *= factor

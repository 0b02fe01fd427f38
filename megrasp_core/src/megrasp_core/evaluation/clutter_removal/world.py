"""What the rounds need of a physics engine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectModel
from megrasp_core.pointcloud import OrientedBox
from megrasp_core.simulation import START_DEPTH, Camera

EDGE = 0.30
"""Edge of the cube on the table in which the objects lie (m)."""
WORKSPACE = OrientedBox(matrix_from_pose7([0, 0, EDGE / 2, 0, 0, 0, 1]), np.full(3, EDGE))
"""The cube; the middle of its floor is the world's origin, z points up."""
FENCE = 0.20
"""Inner edge of the walls between which a pile is dropped (m)."""

MAX_DEPTH = START_DEPTH
"""The open hand may touch up to this depth (m) on its way to the pre-grasp."""
LIFT = 0.10
"""Way of the hand with the object, upwards (m)."""
MIN_RISE = 0.05
"""What has risen by more (m) and still touches the hand is held."""
PUSHED = 0.01
"""An object that closing fingers moved by more (m) was pushed."""


class Outcome(StrEnum):
    """How an attempt ended."""

    SUCCESS = "success"
    COLLISION = "collision"  # the open hand met something on its way
    NO_CONTACT = "no_contact"  # closed on nothing
    OBJECT_MOVED = "object_moved"  # closed on nothing because it had pushed an object away
    SLIPPED = "slipped"  # held when the fingers were closed, lost on the way up
    UNSTABLE = "unstable"  # the physics diverged


@dataclass(frozen=True)
class Attempt:
    """One attempt: its outcome, the objects in the hand at its end, and how deep (m) the open hand
    was in anything on its way.
    """

    outcome: Outcome
    held: tuple[int, ...] = ()
    depth: float = 0.0

    @property
    def success(self) -> bool:
        """Whether something was held at the end."""
        return self.outcome is Outcome.SUCCESS


class ClutterWorld(ABC):
    """Objects on a table and a hand, in some physics engine.

    World frame: z up, the table is z = 0. All objects start outside the scene.
    """

    def __init__(self, objects: Sequence[ObjectModel]) -> None:
        self.objects = tuple(objects)
        self.present: list[int] = []
        """Objects that are in the scene, ascending."""

    @abstractmethod
    def place(self, index: int, world_from_object: NDArray[np.float64]) -> None:
        """Put an object into the scene, at rest, at a pose (4, 4)."""

    @abstractmethod
    def take_out(self, index: int) -> None:
        """Take an object out of the scene."""

    @abstractmethod
    def poses(self) -> NDArray[np.float64]:
        """World-from-object (n, 4, 4) of all objects; of no meaning for those not present."""

    @abstractmethod
    def fence(self, stands: bool) -> None:
        """Put up, or take away, four walls `FENCE` apart that stop objects alone."""

    @abstractmethod
    def run(self, duration: float) -> None:
        """Let time pass (s)."""

    @abstractmethod
    def depth_image(self, camera: Camera) -> NDArray[np.float32]:
        """What a camera sees without noise, (h, w) in m along its axis, 0 where nothing is."""

    @abstractmethod
    def attempt(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64],
        opening: float = 0.0,
    ) -> Attempt:
        """Go straight from the approach pose (4, 4) to the pre-grasp (4, 4), close, lift by
        `LIFT`; the hand leaves the scene as the attempt has left it.

        opening: share of the way from open to closed at which the fingers start.
        """

    def last_hand(self) -> NDArray[np.uint8] | None:
        """Picture (h, w, 3) of the last attempt with its fingers closed, where there is one."""
        return None

    def close(self) -> None:  # noqa: B027
        """Let go of what the engine holds."""


def come_to_rest(world: ClutterWorld, longest: float = 4.0) -> bool:
    """Let time pass until no object moves; False where some still do after `longest` s."""
    step, before, elapsed = 0.25, world.poses(), 0.0
    while elapsed < longest:
        world.run(step)
        elapsed += step
        after = world.poses()
        moved = (after - before)[world.present]
        # An entry of a rotation by 2 degrees differs by 0.035.
        if (np.abs(moved[:, :3, 3]) < 0.001).all() and (np.abs(moved[:, :3, :3]) < 0.035).all():
            return True
        before = after
    return False


def take_out_lost(world: ClutterWorld) -> list[int]:
    """Take out the objects whose middle is outside the workspace; which they were."""
    centres = world.poses()[:, :3, 3]
    lost = [i for i in world.present if not WORKSPACE.contains(centres[i : i + 1])[0]]
    for index in lost:
        world.take_out(index)
    return lost

"""The rounds' world in MuJoCo, with the project's own hands and verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper
from megrasp_core.objects import ObjectModel
from megrasp_core.simulation import (
    Camera,
    Guard,
    Reason,
    Shake,
    TrialSettings,
    build_world,
    judge,
    render_depth,
)

from .world import FENCE, LIFT, MAX_DEPTH, MIN_RISE, PUSHED, Attempt, ClutterWorld, Outcome

TRIAL = TrialSettings(
    max_depth=MAX_DEPTH, lift_height=LIFT, min_rise=MIN_RISE, shake=Shake(0.0, duration=0.0)
)
"""The verdict of the other protocols, but for the height and the shake."""
OUTCOMES = {
    Reason.SUCCESS: Outcome.SUCCESS,
    Reason.START_COLLISION: Outcome.COLLISION,
    Reason.APPROACH_COLLISION: Outcome.COLLISION,
    Reason.NO_CONTACT: Outcome.NO_CONTACT,
    Reason.SLIPPED: Outcome.SLIPPED,
    Reason.NOT_LIFTED: Outcome.SLIPPED,
    Reason.UNSTABLE: Outcome.UNSTABLE,
}


class MujocoWorld(ClutterWorld):
    """Objects, table and any gripper."""

    def __init__(
        self, objects: Sequence[ObjectModel], gripper: Gripper, *, friction: float = 0.8
    ) -> None:
        """Make the world; friction: sliding friction of everything."""
        super().__init__(objects)
        self._world = build_world(
            objects, gripper=gripper, friction=friction, guard=Guard((FENCE, FENCE))
        )
        self._world.set_guard(False)

    def place(self, index: int, world_from_object: NDArray[np.float64]) -> None:
        """Put an object into the scene, at rest, at a pose (4, 4)."""
        self._world.place_object(index, world_from_object)
        self._world.forward()
        self.present = self._world.present

    def take_out(self, index: int) -> None:
        """Take an object out of the scene."""
        self._world.park_object(index)
        self.present = self._world.present

    def poses(self) -> NDArray[np.float64]:
        """World-from-object (n, 4, 4) of all objects."""
        return self._world.object_poses()

    def fence(self, stands: bool) -> None:
        """Put up, or take away, four walls that stop objects alone."""
        self._world.set_guard(stands)

    def run(self, duration: float) -> None:
        """Let time pass (s)."""
        self._world.step(round(duration / self._world.model.opt.timestep))

    def depth_image(self, camera: Camera) -> NDArray[np.float32]:
        """What a camera sees without noise, (h, w) in m along its axis, 0 where nothing is."""
        return render_depth(self._world, camera)

    def attempt(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64],
        opening: float = 0.0,
    ) -> Attempt:
        """See `ClutterWorld.attempt`."""
        before = self.poses()
        verdict = judge(
            self._world,
            world_from_gripper,
            approach=approach,
            opening=opening,
            settings=TRIAL,
        )
        outcome = OUTCOMES[verdict.reason]
        shift = np.linalg.norm(self.poses()[:, :3, 3] - before[:, :3, 3], axis=1)
        if outcome is Outcome.NO_CONTACT and any(shift[i] > PUSHED for i in self.present):
            outcome = Outcome.OBJECT_MOVED
        self._world.park_gripper()
        held = verdict.lifted if verdict.success else ()
        return Attempt(outcome, held, verdict.depth)

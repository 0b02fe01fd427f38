"""The cycle of a robot that picks: look, try what was planned, leave the scene as the attempt left
it, remember what failed. The one used by the cell, the protocols and the rollouts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CancelledError, SimulationError
from megrasp_core.pointcloud import Cloud
from megrasp_core.simulation import (
    Camera,
    DepthNoise,
    Reason,
    Verdict,
    World,
    judge,
    observe,
)
from megrasp_core.synthesizer import RankedGrasp

from .failure_memory import FailureMemory
from .rest import come_to_rest


class PickCycle:
    """A robot at one scene.

    Attributes:
        world: the scene; the cycle moves gripper and objects in it.
        obstacles: objects that must not be lifted.
        failures: where grasps failed, to be excluded from the next plan.
        joints: of the gripper when it had closed in the last attempt; empty where it has not.
    """

    def __init__(self, world: World, obstacles: Collection[int] = ()) -> None:
        self.world = world
        self.obstacles = frozenset(obstacles)
        self.failures = FailureMemory()
        self.joints: dict[str, float] = {}

    @property
    def left(self) -> list[int]:
        """Objects that are there and may be lifted."""
        return sorted(set(self.world.present) - self.obstacles)

    def look(
        self,
        cameras: Camera | Sequence[Camera],
        noise: DepthNoise | None,
        rng: np.random.Generator,
    ) -> Cloud:
        """The scene as cameras see it, the gripper out of the way."""
        self.world.park_gripper()
        return observe(self.world, cameras, noise, rng)

    def verdict(self, grasp: RankedGrasp, *, approach: bool = True) -> Verdict:
        """What would become of a grasp; the scene is as before afterwards."""
        state = self.world.save()
        try:
            return self._try(grasp.world_from_gripper, self._way(grasp, approach), grasp.share)
        finally:
            self.world.restore(state)

    def execute(self, grasp: RankedGrasp, *, approach: bool = True) -> Verdict:
        """Carry out a grasp; see `carry_out`. What fails is remembered."""
        way = self._way(grasp, approach)
        verdict = self.carry_out(grasp.world_from_gripper, way, grasp.share)
        self.failures.count(verdict.success, grasp.world_from_tcp)
        return verdict

    def carry_out(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64] | None = None,
        opening: float = 0.0,
        *,
        on_phase: Callable[[str], None] | None = None,
    ) -> Verdict:
        """Approach, close, lift, shake; what was lifted leaves the scene, the gripper too, and the
        rest comes to rest.

        Args:
            world_from_gripper: (4, 4) pre-grasp.
            approach: (4, 4) world_from_gripper at the stand-off, from where the path to the
                pre-grasp is tested for collision; None: no path is tested.
            opening: share of the way from open to closed at which the fingers start.
            on_phase: called at the beginning of `approach`, `close`, `lift` and `drop`; may raise
                CancelledError.

        Raises:
            SimulationError: the physics diverged; the scene is as before then.
            CancelledError: of `on_phase`; the scene is as before.
        """
        before, self.joints = self.world.save(), {}
        begun = ""

        def begin(phase: str) -> None:
            nonlocal begun
            begun = phase
            if phase == "lift":
                self.joints = self.world.hand.joints()
            if on_phase is not None:
                on_phase(phase)

        try:
            verdict = self._try(world_from_gripper, approach, opening, begin)
            if begun == "close" and verdict.reason is not Reason.UNSTABLE:
                # Closed on nothing that could be lifted.
                self.joints = self.world.hand.joints()
            if verdict.success and on_phase is not None:
                on_phase("drop")
            self.clear(verdict.lifted if verdict.success else ())
        except (SimulationError, CancelledError):
            self.world.restore(before)
            raise
        return verdict

    def clear(self, objects: Collection[int]) -> None:
        """Take objects and the gripper out of the scene and let the rest come to rest.

        What a failed attempt had raised slipped out and is on its way down again.
        """
        for index in objects:
            self.world.park_object(index)
        self.world.park_gripper()
        come_to_rest(self.world)

    def _try(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64] | None,
        opening: float,
        on_phase: Callable[[str], None] | None = None,
    ) -> Verdict:
        return judge(
            self.world,
            world_from_gripper,
            graspable=self.left,
            approach=approach,
            opening=opening,
            on_phase=on_phase,
        )

    def _way(self, grasp: RankedGrasp, approach: bool) -> NDArray[np.float64] | None:
        return grasp.world_from_gripper_approach if approach else None

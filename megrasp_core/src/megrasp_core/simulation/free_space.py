"""Free-space trial: one object floats without gravity, as labels need it.

(a) and (b) of the verdict against the object alone, then +-5 cm at 2 Hz for 1 s along the
gripper's approach and Y axes and +-0.4 rad at 2 Hz for 1 s about its closing and Y axes through
the TCP, each pair a quarter period apart. These are the directions in which a pinched object can
slide or turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .motion import ContactWatch, Motion, Shake, advance, closing, step_times
from .verdict import Reason, TrialSettings
from .world import World, build_world

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.objects import ObjectModel


@dataclass(frozen=True)
class FreeSpaceSettings:
    """Numbers of the free-space trial.

    Attributes:
        start: start collision and closing, as in the verdict.
        shift: shaking along an axis (m).
        turn: shaking about an axis (rad).
    """

    start: TrialSettings = field(default_factory=TrialSettings)
    shift: Shake = field(default_factory=lambda: Shake(0.05))
    turn: Shake = field(default_factory=lambda: Shake(0.4))


@dataclass(frozen=True)
class FreeSpaceResult:
    """Outcome of one free-space trial.

    Attributes:
        success: the object was in contact to the end.
        reason: why not.
        depth: start penetration (m).
        slip: how far the held object's centre moved in the gripper frame while it was shaken (m).
        turn: how far it turned there (rad).
    """

    success: bool
    reason: Reason
    depth: float
    slip: float = 0.0
    turn: float = 0.0

    @property
    def quality(self) -> float:
        """From 0, lost, to 1, held like glued: exp(-slip / 1 cm - turn / 0.2 rad)."""
        return float(np.exp(-self.slip / 0.01 - self.turn / 0.2)) if self.success else 0.0


SPARSE_FROM = 24
"""Degrees of freedom from which trials take sparse constraint Jacobians, since a contact moves one
finger only: trials of hands get faster, those of jaws would get slower. MuJoCo's own bound is 60.
"""


def label_timestep(gripper: Gripper) -> float:
    """Timestep (s) of the gripper's labels: 4 ms, for hands 3 ms.

    `megrasp bench --stage data` measures how often labels are those of 2 ms on the same grasps,
    and how often two runs at 2 ms agree whose grasps differ by 0.05 mm.
    """
    return 0.003 if gripper.description.kind == "hand" else 0.004


class FreeSpaceRig:
    """One gripper and one object, compiled once for many trials.

    timestep: that of `label_timestep` by default; the verdict in heaps takes 0.002 s.
    locked: whether joints that the gripper's grasps do not move are fixed (`idle.py`).
    """

    def __init__(
        self,
        gripper: Gripper,
        object: ObjectModel,
        *,
        timestep: float | None = None,
        friction: float | None = None,
        locked: bool = True,
        settings: FreeSpaceSettings | None = None,
    ) -> None:
        self.settings = settings or FreeSpaceSettings()
        self.world: World = build_world(
            [object],
            gripper=gripper,
            table=False,
            gravity=False,
            timestep=label_timestep(gripper) if timestep is None else timestep,
            friction=friction,
            visual=False,
            locked=locked,
        )
        model = self.world.model
        # One island holds all there is; looking for more costs 5 to 8 % of a trial.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        if locked and model.nv >= SPARSE_FROM:
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        self._start = self.world.save()
        start = self.settings.start
        self._closing = closing(self.world, start.close_time, start.close_ramp)
        self._shakes = (self._shift(), self._turn(np.asarray(gripper.tcp, dtype=np.float64)))

    def depth(self, object_from_gripper: NDArray[np.float64]) -> float:
        """Penetration (m) of the open gripper at a pose (4, 4) in the object's frame."""
        self._place(object_from_gripper)
        return self.world.gripper_depth()

    def trial(self, object_from_gripper: NDArray[np.float64]) -> FreeSpaceResult:
        """Try one pre-grasp (4, 4), given in the object's frame."""
        world, settings = self.world, self.settings
        depth = self.depth(object_from_gripper)
        if depth > settings.start.max_depth:
            return FreeSpaceResult(False, Reason.START_COLLISION, depth)
        world.clear_warnings()
        advance(world, self._closing)
        watch = ContactWatch(world, world.touched()[0])
        if not world.unstable() and not watch.held:
            return FreeSpaceResult(False, Reason.NO_CONTACT, depth)
        before = self._gripper_from_object()
        held = all(advance(world, motion, watch) for motion in self._shakes)
        if world.unstable():
            return FreeSpaceResult(False, Reason.UNSTABLE, depth)
        if not held:
            return FreeSpaceResult(False, Reason.SLIPPED, depth)
        moved = self._gripper_from_object() @ np.linalg.inv(before)
        turn = Rotation.from_matrix(moved[:3, :3]).magnitude()
        slip = np.linalg.norm((moved @ before - before)[:3, 3])
        return FreeSpaceResult(True, Reason.SUCCESS, depth, float(slip), float(turn))

    def _gripper_from_object(self) -> NDArray[np.float64]:
        return np.linalg.inv(self.world.hand.pose()) @ self.world.object_poses()[0]

    def _place(self, object_from_gripper: NDArray[np.float64]) -> None:
        """Gripper at the origin: the shakes are then the same for every trial."""
        self.world.restore(self._start)
        inverse = np.linalg.inv(object_from_gripper).astype(np.float64)
        self.world.place_object(0, inverse)
        self.world.place_gripper(np.eye(4))

    def _shift(self) -> Motion:
        """Move along the gripper's Z and Y axes."""
        offsets = self.settings.shift.offsets(step_times(self.world, self.settings.shift.duration))
        positions = np.zeros((len(offsets), 3))
        positions[:, [2, 1]] = offsets
        return Motion(len(positions), positions)

    def _turn(self, tcp: NDArray[np.float64]) -> Motion:
        """Turn about the axes through the TCP (3,) that are parallel to the gripper's X and Y."""
        offsets = self.settings.turn.offsets(step_times(self.world, self.settings.turn.duration))
        turns = Rotation.from_rotvec(np.pad(offsets, ((0, 0), (0, 1))))
        quaternions = np.roll(turns.as_quat(), 1, axis=1)
        return Motion(len(offsets), tcp - turns.apply(tcp), quaternions)

"""The gripper in a world: dragged by its mount, fingers driven between two postures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import SimulationError

from .assembly import GRIPPER_PREFIX
from .coordinates import read_pose, write_pose
from .idle import IdleParts, idle_parts

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

HandPosture = Literal["open", "closed"] | float
"""By name, or as a share of the way from open to closed (`Gripper.stroke`)."""


class Hand:
    """Indices and commands of the gripper of one MuJoCo model.

    position (3,), quaternion (4,) w first: where the gripper is dragged to; writing to them moves
        the target. locked: the model has no idle parts (`idle.py`). Raises SimulationError when
        the gripper's postures or controls do not fit its model.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, gripper: Gripper, *, locked: bool
    ) -> None:
        self.gripper = gripper
        self._data = data
        mocap = int(model.body("hand").mocapid[0])
        self.position: NDArray[np.float64] = data.mocap_pos[mocap]
        self.quaternion: NDArray[np.float64] = data.mocap_quat[mocap]
        self._ctrl: NDArray[np.float64] = data.ctrl
        self._mount = np.arange(7) + int(model.joint("mount").qposadr[0])
        joints = {
            model.joint(j).name: int(model.jnt_qposadr[j])
            for j in range(model.njnt)
            if model.joint(j).name.startswith(GRIPPER_PREFIX)
        }
        self._postures: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}
        self._controls: dict[str, NDArray[np.float64]] = {}
        idle = idle_parts(gripper) if locked else IdleParts()
        for which in ("open", "closed"):
            posture = {
                GRIPPER_PREFIX + name: q
                for name, q in gripper.posture(which).items()
                if name not in idle.joints
            }
            control = np.delete(gripper.control(which), list(idle.actuators))
            if set(posture) != set(joints) or control.shape != (model.nu,):
                raise SimulationError(
                    f"the {which} posture of gripper {gripper.name!r} names the joints "
                    f"{sorted(posture)} and {control.size} controls; its model has the joints "
                    f"{sorted(joints)} and {model.nu} actuators. Give every joint a value."
                )
            addresses = np.array([joints[name] for name in posture], dtype=np.int64)
            self._postures[which] = addresses, np.array(list(posture.values()), dtype=np.float64)
            self._controls[which] = control
        self._idle = idle.joints
        self._stroke = self._controls["closed"] - self._controls["open"]
        bodies = [
            b
            for b in range(model.nbody)
            if model.body(b).name == "mount" or model.body(b).name.startswith(GRIPPER_PREFIX)
        ]
        self._dof = np.flatnonzero(np.isin(model.dof_bodyid, bodies))

    def place(self, world_from_gripper: NDArray[np.float64], posture: HandPosture) -> None:
        """Put the gripper, at rest in a posture, at a pose (4, 4), driven to hold that posture."""
        data = self._data
        write_pose(data.qpos, self._mount, world_from_gripper)
        self.position[:] = data.qpos[self._mount[:3]]
        self.quaternion[:] = data.qpos[self._mount[3:]]
        addresses, values, control = self._posture(posture)
        data.qpos[addresses] = values
        data.qvel[self._dof] = 0.0
        data.qacc_warmstart[self._dof] = 0.0
        data.act[:] = 0.0
        self._ctrl[:] = control

    def _posture(
        self, posture: HandPosture
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Addresses and values of the joints, and the control."""
        if not isinstance(posture, str):
            if 0.0 < posture < 1.0:
                joints = self.gripper.posture_at(posture)
                values = [q for name, q in joints.items() if name not in self._idle]
                control = self._controls["open"] + posture * self._stroke
                return self._postures["open"][0], np.array(values), control
            posture = "open" if posture <= 0.0 else "closed"
        return *self._postures[posture], self._controls[posture]

    def drive(self, share: float) -> None:
        """Command the fingers: 0 the open posture, 1 the closed one, linear between."""
        self._ctrl[:] = self._controls["open"] + share * self._stroke

    def joints(self) -> dict[str, float]:
        """Positions of the gripper's joints now, by name; locked ones are left out."""
        addresses, _ = self._postures["open"]
        names = [name for name in self.gripper.posture("open") if name not in self._idle]
        return dict(zip(names, self._data.qpos[addresses].tolist(), strict=True))

    def pose(self) -> NDArray[np.float64]:
        """World-from-gripper (4, 4) where the gripper is now."""
        return read_pose(self._data.qpos, self._mount)

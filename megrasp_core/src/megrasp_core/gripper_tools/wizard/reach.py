"""Where a fingertip goes: forward kinematics of one finger for many drive lengths at once."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .fingers import Finger, joint_gains
from .motion import DriveMotion


@dataclass(frozen=True)
class TipStates:
    """Fingertips of M states: `tip` (M, 3), unit `pad` (M, 3): where flexing its last joint
    moves the tip, which is where its pad looks; `lengths` (M, drives of the finger).
    """

    tip: NDArray[np.float64]
    pad: NDArray[np.float64]
    lengths: NDArray[np.float64]


class Reach:
    """Fingertip of one finger over its drives, the others at rest, model frame.

    Couplings are taken as linear about the rest positions, which joint equalities and fixed
    tendons nearly always are; it serves the search, the chosen postures are solved exactly.
    """

    def __init__(
        self, motion: DriveMotion, finger: Finger, gains: NDArray[np.float64] | None = None
    ) -> None:
        model = motion.model
        self.finger = finger
        self.drives = [*finger.curl, *finger.spread]
        self._model = model
        self._gains = (joint_gains(motion) if gains is None else gains)[self.drives]
        self._rest = motion.rest()
        self._qpos = motion.qpos(self._rest)
        path = []
        body = finger.tip_body
        while body:
            path.append(body)
            body = int(model.body_parentid[body])
        self._path = path[::-1]

    def states(self, lengths: NDArray[np.float64]) -> TipStates:
        """Return the tips for lengths (M, n) of this finger's drives, curl first, then spread."""
        model, count = self._model, len(lengths)
        adr = model.jnt_qposadr
        change = (lengths - self._rest[self.drives]) @ self._gains
        q = self._qpos[adr] + change - model.qpos0[adr]
        turn, place = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        axis, anchor = np.zeros((count, 3)), np.zeros((count, 3))
        slide = True
        for body in self._path:
            place = place + turn @ model.body_pos[body]
            turn = turn @ _matrix(model.body_quat[body])
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                local = model.jnt_axis[joint]
                if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                    place = place + (turn @ local) * q[:, joint, None]
                    axis, slide = turn @ local, True
                    continue
                before = place + turn @ model.jnt_pos[joint]
                turn = turn @ Rotation.from_rotvec(q[:, joint, None] * local).as_matrix()
                place = before - turn @ model.jnt_pos[joint]
                if joint in self.finger.moving:
                    axis, anchor, slide = turn @ local, before, False
        tip = place + turn @ self.finger.tip_point
        flow = axis if slide else np.cross(axis, tip - anchor)
        pad = flow * self.finger.sense
        return TipStates(tip, pad / np.linalg.norm(pad, axis=1, keepdims=True), lengths)


def _matrix(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of MuJoCo's (w, x, y, z)."""
    return Rotation.from_quat(np.roll(quat, -1)).as_matrix()

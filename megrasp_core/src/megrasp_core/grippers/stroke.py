"""Postures between open and closed, as the fingers take them when they close on nothing."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from .geometry import body_poses
from .posture import Posture, settle

STEPS = 16
"""The stroke is known at so many equal parts of the way of the command."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """S postures from open to closed.

    shares: (S,) of the way of the command, 0 open to 1 closed. qpos: (S, nq) of `Gripper.model`.
    bodies: (S, nbody, 4, 4) gripper_from_body.
    """

    shares: NDArray[np.float64]
    qpos: NDArray[np.float64]
    bodies: NDArray[np.float64]

    def moved(self, points: NDArray[np.float64], body: NDArray[np.int64]) -> NDArray[np.float64]:
        """Points (P, 3) of the open gripper on the bodies (P,), along the stroke: (S, P, 3)."""
        step = (self.bodies @ np.linalg.inv(self.bodies[0]))[:, body]
        return np.einsum("spij,pj->spi", step[..., :3, :3], points) + step[..., :3, 3]

    def qpos_at(self, share: float) -> NDArray[np.float64]:
        """Joint positions (nq,) at a share of the way, linear between the known postures."""
        return np.array([np.interp(share, self.shares, column) for column in self.qpos.T])


def drive_stroke(
    model: mujoco.MjModel, opened: Posture, closed: Posture, steps: int = STEPS
) -> NDArray[np.float64]:
    """Joint positions (steps + 1, nq) from open to closed, driven in simulation, so that linkages
    hold together on the way.

    Where the simulation does not come to rest, or does not come from the one posture to the
    other, the joints go straight.
    """
    shares = np.linspace(0.0, 1.0, steps + 1)
    straight = opened.qpos + shares[:, None] * (closed.qpos - opened.qpos)
    driven = straight.copy()
    for index in range(1, steps):
        control = opened.control + shares[index] * (closed.control - opened.control)
        driven[index] = settle(model, control, start=driven[index - 1])
    reach = np.abs(closed.qpos - opened.qpos).max(initial=0.0)
    jump = np.abs(np.diff(driven, axis=0)).max(initial=0.0)
    sound = np.isfinite(driven).all() and jump <= 4.0 * reach / steps + 1e-6
    return driven if sound else straight


def make_stroke(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> Stroke:
    """The stroke of joint positions (S, nq)."""
    bodies = np.stack([body_poses(model, row) for row in qpos])
    return Stroke(np.linspace(0.0, 1.0, len(qpos)), qpos, bodies)

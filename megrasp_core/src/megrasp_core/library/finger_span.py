"""Where opposing fingers meet an object of a given width.

The fingers close in simulation; along the way the points of the first finger group and of the
groups that oppose it which are nearest to each other tell how wide an object may be there, where
its middle lies and along which axis it is pressed. Jaws whose pads move forward while they close
and hands whose fingertips do not meet at the TCP are thus taken alike.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.grippers import body_poses, surface_points
from megrasp_core.grippers.geometry import posed

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

STEPS = 25
"""Postures looked at on the way from open to closed."""

CLOSING_TIME = 1.5
"""Slow enough for the drives to follow (s)."""

SPACING = 0.003
"""Of the points on the fingers (m)."""

PATCH = 0.004
"""Points this much further apart than the nearest ones count with weight 1/e (m)."""

FINGER = 0.010
"""The same for whole fingers that oppose the first group together (m)."""

NEAR_TCP = 0.03
"""Only where the middle is this near to the TCP do fingers count as opposed (m): knuckles are
often nearer to each other than fingertips are.
"""


@dataclass(frozen=True)
class FingerSpan:
    """Middle and axis of the space between opposing fingers, by its width; all in the gripper
    frame.

    Attributes:
        width: (k,) ascending (m), from closed to open.
        middle: (k, 3) between the nearest points (m).
        axis: (k, 3) unit vectors from the first group to those that oppose it.
    """

    width: NDArray[np.float64]
    middle: NDArray[np.float64]
    axis: NDArray[np.float64]

    @classmethod
    def of(cls, gripper: Gripper) -> FingerSpan | None:
        """Close the gripper on nothing and look at its fingers on the way; None where opposing
        groups do not come nearer to each other around the TCP.
        """
        meshes = gripper.body_meshes("collision")
        groups = gripper.finger_groups[[mesh.body for mesh in meshes]]
        fingers = [mesh for mesh, group in zip(meshes, groups, strict=True) if group >= 0]
        open_poses = gripper.body_poses("open")
        sample = surface_points(posed(fingers, open_poses), SPACING)
        body = np.array([mesh.body for mesh in fingers])[sample.mesh]
        first = gripper.finger_groups[body] == 0
        finger = _fingers(gripper)[body]
        looks: list[Look] = []
        for qpos in _closing(gripper):
            step = body_poses(gripper.model, qpos) @ np.linalg.inv(open_poses)
            points = np.einsum("nij,nj->ni", step[body, :3, :3], sample.points)
            points += step[body, :3, 3]
            patches = [
                _nearest(points[first], points[finger == other], gripper.tcp)
                for other in np.unique(finger[~first])
            ]
            looks += _together([patch for patch in patches if patch is not None])
        gap = np.array([look[0] for look in looks])
        # From the narrowest on the fingers have passed each other.
        last = int(np.argmin(gap)) if looks else 0
        if last == 0:
            return None
        order = np.arange(last, -1, -1)
        order = order[np.r_[True, np.diff(np.maximum.accumulate(gap[order])) > 0.0]]
        return cls(
            gap[order],
            np.array([look[1] for look in looks])[order],
            np.array([look[2] for look in looks])[order],
        )

    @property
    def widest(self) -> float:
        """Distance between the open fingers where they are nearest to each other (m)."""
        return float(self.width[-1])

    def at(self, width: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Middle (n, 3) and unit axis (n, 3) for objects of widths (n,), interpolated."""
        middle, axis = (
            np.stack([np.interp(width, self.width, column) for column in table.T], axis=1)
            for table in (self.middle, self.axis)
        )
        return middle, axis / np.linalg.norm(axis, axis=1, keepdims=True)


@functools.lru_cache(maxsize=16)
def hand_span(gripper: Gripper) -> FingerSpan | None:
    """Where the fingers of a hand meet; None for jaws, which close along +X at the TCP."""
    return FingerSpan.of(gripper) if gripper.description.kind == "hand" else None


def _closing(gripper: Gripper) -> list[NDArray[np.float64]]:
    """Joint positions (nq,) at `STEPS` moments of closing on nothing, without gravity."""
    model = copy.copy(gripper.model)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = gripper.qpos("open")
    start, end = gripper.control("open"), gripper.control("closed")
    steps = round(CLOSING_TIME / model.opt.timestep / (STEPS - 1))
    out = [data.qpos.copy()]
    for share in np.linspace(0.0, 1.0, STEPS)[1:]:
        data.ctrl[:] = start + share * (end - start)
        mujoco.mj_step(model, data, nstep=steps)
        out.append(data.qpos.copy())
    return out


def _fingers(gripper: Gripper) -> NDArray[np.int64]:
    """The uppermost body (nbody,) of the finger that each body of a finger group belongs to."""
    model, groups = gripper.model, gripper.finger_groups
    out = np.arange(model.nbody)
    for body in range(1, model.nbody):
        parent = model.body_parentid[body]
        if groups[body] >= 0 and groups[parent] == groups[body]:
            out[body] = out[parent]
    return out


Look = tuple[float, NDArray[np.float64], NDArray[np.float64]]
"""Least distance of two point sets (m), and middle (3,) and vector across (3,) there."""


def _nearest(
    first: NDArray[np.float64], second: NDArray[np.float64], tcp: NDArray[np.float64]
) -> Look | None:
    """Look at the point sets (n, 3) and (m, 3) near the TCP (3,); None where none are near it."""
    distance, other = KDTree(second).query(first)
    across = second[other] - first
    middles = first + 0.5 * across
    near = np.linalg.norm(middles - tcp, axis=1) < NEAR_TCP
    if not near.any():
        return None
    distance, across, middles = distance[near], across[near], middles[near]
    gap = float(distance.min())
    weight = np.exp(-(distance - gap) / PATCH)[:, None]
    weight /= weight.sum()
    return gap, (weight * middles).sum(axis=0), (weight * across).sum(axis=0)


def _together(patches: list[Look]) -> list[Look]:
    """One look for all opposing fingers, nearer ones with more weight; none for none."""
    if not patches:
        return []
    gaps = np.array([patch[0] for patch in patches])
    weight = np.exp(-(gaps - gaps.min()) / FINGER)[:, None]
    weight /= weight.sum()
    middle = (weight * np.array([patch[1] for patch in patches])).sum(axis=0)
    across = (weight * np.array([patch[2] for patch in patches])).sum(axis=0)
    return [(float(gaps.min()), middle, across / max(float(np.linalg.norm(across)), 1e-12))]

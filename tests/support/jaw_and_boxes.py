"""A two-finger jaw and boxes, small enough to know every answer beforehand."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import trimesh

from megrasp_core.objects import ObjectModel


class Jaw:
    """Parallel jaw in its gripper frame: pads at x = -0.04 and 0.04 when open, tips at z = 0.11.

    Each pad is 1 cm thick outwards, 2 cm wide (y) and 5 cm long; 40 N a finger.
    """

    name = "jaw"
    description = SimpleNamespace(kind="parallel")
    tcp = np.array([0.0, 0.0, 0.10])
    tip = 0.11

    def spec(self) -> mujoco.MjSpec:
        """Return a fresh model."""
        spec = mujoco.MjSpec()
        root = spec.worldbody.add_body(name="gripper")
        box = mujoco.mjtGeom.mjGEOM_BOX
        solid = {"contype": 2, "conaffinity": 1, "condim": 4, "solref": [0.004, 1.0], "group": 3}
        root.add_geom(type=box, size=[0.05, 0.02, 0.03], pos=[0, 0, 0.03], mass=0.5, **solid)
        root.add_geom(
            type=box,
            size=[0.05, 0.02, 0.03],
            pos=[0, 0, 0.03],
            mass=0,
            contype=0,
            conaffinity=0,
            group=2,
        )
        for name, side in (("left", -1), ("right", 1)):
            finger = root.add_body(name=name, pos=[0, 0, 0.06])
            finger.add_joint(
                name=f"{name}_joint",
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=[1, 0, 0],
                damping=20,
                armature=0.1,
            )
            finger.add_geom(
                type=box,
                size=[0.005, 0.01, 0.025],
                pos=[side * 0.005, 0, 0.025],
                mass=0.05,
                **solid,
            )
            drive = spec.add_actuator(
                name=name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                target=f"{name}_joint",
                forcerange=[-40, 40],
                forcelimited=True,
            )
            drive.set_to_position(kp=4000)
        return spec

    @property
    def model(self) -> mujoco.MjModel:
        """Return the compiled model."""
        return self.spec().compile()

    def control(self, which: str) -> np.ndarray:
        """Return the commands (2,) of a posture."""
        return np.array([-0.04, 0.04]) if which == "open" else np.zeros(2)

    def posture(self, which: str) -> dict[str, float]:
        """Return all joint positions of a posture."""
        left, right = self.control(which)
        return {"left_joint": float(left), "right_joint": float(right)}


def make_box(
    size: tuple[float, float, float], mass: float = 0.1, name: str = "box"
) -> ObjectModel:
    """Return a solid box with full edges `size` (m)."""
    mesh = trimesh.creation.box(size)
    x, y, z = size
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    piece = (np.asarray(mesh.vertices), np.asarray(mesh.faces))
    return ObjectModel(name, *piece, (piece,), mass, inertia, colour=(0.2, 0.5, 0.8))


def at(x: float, y: float, z: float) -> np.ndarray:
    """Return an upright pose (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def down(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    """Return the gripper pose (4, 4) that looks straight down with the jaw's tips at height z."""
    pose = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    pose[:3, :3] = np.array([[c, s, 0], [s, -c, 0], [0, 0, -1]])
    pose[:3, 3] = x, y, z + Jaw.tip
    return pose

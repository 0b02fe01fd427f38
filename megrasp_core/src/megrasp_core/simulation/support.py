"""What objects lie on: the table plane and, on it, an open bin.

World frame: z up, the support surface is z = 0, the bin stands centred on the origin with its
edges along x and y, or is propped up on one side.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.pointcloud import OrientedBox

SCENERY_GROUP = 1
"""Geom group of table and bin: they collide and the camera sees them."""

SCENERY_COLOUR = (0.72, 0.72, 0.70)


@dataclass(frozen=True)
class Bin:
    """An open box on the table.

    inner: inside edges (x, y, z) in m, z being the height of the walls.
    wall: thickness of the four walls in m.
    tilt: rotation vector (x, y), rad, by which the bin is turned; one that is tilted stands on an
        edge and has a floor as thick as its walls, the floor of one that is not is the table.
    colour: RGB in 0..1.
    """

    inner: tuple[float, float, float] = (0.40, 0.30, 0.15)
    wall: float = 0.008
    tilt: tuple[float, float] = (0.0, 0.0)
    colour: tuple[float, float, float] = SCENERY_COLOUR

    @property
    def world_from_bin(self) -> NDArray[np.float64]:
        """Pose (4, 4) of the bin's frame: origin in the middle of the floor, z along the walls."""
        pose = np.eye(4)
        if any(self.tilt):
            pose[:3, :3] = Rotation.from_rotvec([*self.tilt, 0.0]).as_matrix()
            outer = np.append(np.array(self.inner[:2]) / 2.0 + self.wall, self.wall)
            pose[2, 3] = np.abs(pose[2, :3]) @ outer
        return pose

    def region(self) -> OrientedBox:
        """Inside of the bin, from the floor to the rim, in the world frame."""
        middle = np.eye(4)
        middle[2, 3] = self.inner[2] / 2.0
        return OrientedBox(self.world_from_bin @ middle, np.asarray(self.inner, dtype=np.float64))

    def wall_boxes(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Centre (3,) and half edges (3,) of the four walls, bin frame, m."""
        x, y, z = (edge / 2.0 for edge in self.inner)
        t = self.wall / 2.0
        boxes = []
        for sign in (-1.0, 1.0):
            boxes.append((np.array([sign * (x + t), 0, z]), np.array([t, y + self.wall, z])))
            boxes.append((np.array([0, sign * (y + t), z]), np.array([x, t, z])))
        return boxes

    def floor_boxes(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Centre (3,) and half edges (3,) of the floor, bin frame, m; none where the table is the
        floor.
        """
        if not any(self.tilt):
            return []
        x, y, t = self.inner[0] / 2.0, self.inner[1] / 2.0, self.wall / 2.0
        return [(np.array([0.0, 0.0, -t]), np.array([x + self.wall, y + self.wall, t]))]


def add_support(
    spec: mujoco.MjSpec,
    bin: Bin | None,
    *,
    contype: int,
    conaffinity: int,
    friction: tuple[float, float, float],
    solref: tuple[float, ...],
    solimp: tuple[float, ...],
) -> None:
    """Add the table plane "table" and the boxes "bin_0".. of the bin to the world body.

    Args:
        spec: to add them to.
        bin: the bin; None: the table alone.
        contype: bits of what they are to others.
        conaffinity: bits of what they touch.
        friction: sliding, torsional (m), rolling (m).
        solref: of their contacts, as MuJoCo has it.
        solimp: likewise.
    """
    common = {
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 4,
        "friction": list(friction),
        "solref": list(solref),
        "solimp": list(solimp),
        "group": SCENERY_GROUP,
        "rgba": [*(SCENERY_COLOUR if bin is None else bin.colour), 1.0],
    }
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1], **common
    )
    if bin is None:
        return
    pose = bin.world_from_bin
    quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)
    for index, (centre, half) in enumerate([*bin.wall_boxes(), *bin.floor_boxes()]):
        spec.worldbody.add_geom(
            name=f"bin_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(pose[:3, :3] @ centre + pose[:3, 3]).tolist(),
            quat=quaternion.tolist(),
            size=half.tolist(),
            **common,
        )


def add_guard(
    spec: mujoco.MjSpec, inner: tuple[float, float], bottom: float, height: float, *, contype: int
) -> None:
    """Add four tall invisible walls "guard_0".. around an area of inner edges (x, y) centred on
    the origin.

    They touch only bodies whose conaffinity holds their own bit, so that falling objects stay in
    while a gripper passes through.
    """
    x, y, z, t = inner[0] / 2.0, inner[1] / 2.0, height / 2.0, 0.05
    walls = [((sx * (x + t), 0.0), (t, y + 2 * t)) for sx in (-1.0, 1.0)] + [
        ((0.0, sy * (y + t)), (x, t)) for sy in (-1.0, 1.0)
    ]
    for index, (centre, half) in enumerate(walls):
        spec.worldbody.add_geom(
            name=f"guard_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[*centre, bottom + z],
            size=[*half, z],
            contype=contype,
            conaffinity=0,
            condim=3,
            friction=[0.0, 0.0, 0.0],
            group=5,
            rgba=[0.0, 0.0, 0.0, 0.0],
        )

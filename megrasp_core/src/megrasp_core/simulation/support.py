"""What objects lie on: the table plane and, on it, an open bin.

World frame: z up, the support surface is z = 0, the bin stands centred on the origin with its
edges along x and y (DESIGN section 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud import OrientedBox

SCENERY_GROUP = 1
"""Geom group of table and bin: they collide and the camera sees them."""

SCENERY_COLOUR = (0.72, 0.72, 0.70, 1.0)


@dataclass(frozen=True)
class Bin:
    """An open box on the table.

    inner: inside edges (x, y, z) in m, z being the height of the walls.
    wall: thickness of the four walls in m; the bottom is the table plane z = 0.
    """

    inner: tuple[float, float, float] = (0.40, 0.30, 0.15)
    wall: float = 0.008

    def region(self) -> OrientedBox:
        """Inside of the bin, from the floor to the rim, in the world frame."""
        pose = np.eye(4)
        pose[2, 3] = self.inner[2] / 2.0
        return OrientedBox(pose, np.asarray(self.inner, dtype=np.float64))

    def wall_boxes(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Centre (3,) and half edges (3,) of the four walls, world frame, m."""
        x, y, z = (edge / 2.0 for edge in self.inner)
        t = self.wall / 2.0
        boxes = []
        for sign in (-1.0, 1.0):
            boxes.append((np.array([sign * (x + t), 0, z]), np.array([t, y + self.wall, z])))
            boxes.append((np.array([0, sign * (y + t), z]), np.array([x, t, z])))
        return boxes


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
    """Add the table plane "table" and, if given, the walls "bin_0".."bin_3" of the bin to the
    world body.
    """
    common = {
        "contype": contype,
        "conaffinity": conaffinity,
        "condim": 4,
        "friction": list(friction),
        "solref": list(solref),
        "solimp": list(solimp),
        "group": SCENERY_GROUP,
        "rgba": list(SCENERY_COLOUR),
    }
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1], **common
    )
    for index, (centre, half) in enumerate(bin.wall_boxes() if bin is not None else ()):
        spec.worldbody.add_geom(
            name=f"bin_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=centre.tolist(),
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

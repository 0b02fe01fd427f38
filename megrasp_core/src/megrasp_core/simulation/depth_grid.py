"""A quick first look at start collisions: how deep points of a gripper are in a settled scene.

All collision shapes are convex, so the depth of a point in one is the least distance to its faces.
The depths in the scene are written into a grid once; looking up a few hundred points of the open
gripper then costs microseconds a pose. Two bodies that share a point have to move by its depth in
either of them to part, so what is rejected surely collides; what is not goes on to the exact test
(start_collision.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.simulation.verdict import TrialSettings
from megrasp_core.simulation.world import GRIPPER, World

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

SPACING = 0.003
"""Of the grid (m)."""

OFF_GRID = 0.5 * np.sqrt(3.0) * SPACING
"""A point is at most this far from its grid point (m)."""

SURFACE_SPACING, INNER_SPACING = 0.008, 0.006
"""Of the points on and in the gripper (m)."""

MAX_DEPTH = TrialSettings.max_depth

CHUNK = 128
"""Poses looked up at a time: their points stay in the cache."""


@dataclass(frozen=True)
class DepthGrid:
    """Depth inside the collision shapes of a scene, on a grid; see `DepthGrid.of`.

    Attributes:
        low: (3,) float32, the first grid point, world frame (m).
        depth: (nx, ny, nz) float32, depth of each grid point in the shapes, 0 outside (m).
        floor: height of the support plane (m), -inf without one.
    """

    low: NDArray[np.float32]
    depth: NDArray[np.float32]
    floor: float

    @classmethod
    def of(cls, world: World) -> DepthGrid:
        """Grid of the scene as it is now, without the gripper and what is parked."""
        model, data = world.model, world.data
        mujoco.mj_kinematics(model, data)
        parked = set(world.parked)
        shapes: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []
        floor = -np.inf
        for geom in range(model.ngeom):
            owner = int(world.owner[geom])
            if owner == GRIPPER or owner in parked or not model.geom_contype[geom]:
                continue
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                floor = float(data.geom_xpos[geom, 2])
                continue
            corners, normals = _shape(model, geom)
            rotation = data.geom_xmat[geom].reshape(3, 3)
            corners = corners @ rotation.T + data.geom_xpos[geom]
            normals = normals @ rotation.T
            shapes.append((corners, normals, (corners @ normals.T).max(axis=0)))
        if not shapes:
            return cls(np.zeros(3, np.float32), np.zeros((1, 1, 1), np.float32), floor)
        low = np.min([corners.min(axis=0) for corners, _, _ in shapes], axis=0)
        high = np.max([corners.max(axis=0) for corners, _, _ in shapes], axis=0)
        size = np.ceil((high - low) / SPACING).astype(int) + 1
        depth = np.zeros(tuple(size), np.float32)
        for corners, normals, offsets in shapes:
            first = np.floor((corners.min(axis=0) - low) / SPACING).astype(int)
            last = np.minimum(np.ceil((corners.max(axis=0) - low) / SPACING).astype(int), size - 1)
            axes = [low[i] + SPACING * np.arange(first[i], last[i] + 1) for i in range(3)]
            # The distance to a face is a sum over the axes, so no grid of points is made.
            parts = [np.outer(normals[:, i], axes[i]) for i in range(3)]
            outside = np.full([len(axis) for axis in axes], -np.inf)
            for x, y, z, offset in zip(*parts, offsets, strict=True):
                plane = (x[:, None, None] + y[None, :, None]) + (z - offset)
                np.maximum(outside, plane, out=outside)
            part = depth[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
            np.maximum(part, -outside, out=part)
        return cls(low.astype(np.float32), depth, floor)

    def collides(
        self, world_from_gripper: NDArray[np.float64], points: GripperPoints
    ) -> NDArray[np.bool_]:
        """Which poses (n, 4, 4) surely bring the open gripper deeper than 1 mm into something:
        (n,).
        """
        out = np.zeros(len(world_from_gripper), bool)
        size = np.array(self.depth.shape, np.int32)
        flat = self.depth.ravel()
        homogeneous = np.pad(points.xyz, ((0, 0), (0, 1)), constant_values=1.0).T
        for start in range(0, len(out), CHUNK):
            poses = world_from_gripper[start : start + CHUNK, :3].astype(np.float32)
            at = poses @ homogeneous
            below = (at[:, 2] < self.floor - MAX_DEPTH).any(axis=1)
            cell = (at - self.low[:, None]) * np.float32(1.0 / SPACING) + np.float32(0.5)
            inside = ((cell >= 0) & (cell < size[:, None])).all(axis=1)
            x, y, z = np.moveaxis(cell.astype(np.int32), 1, 0)
            index = np.where(inside, (x * size[1] + y) * size[2] + z, 0)
            deep = (flat[index] > points.allowed) & inside
            out[start : start + CHUNK] = below | deep.any(axis=1)
        return out


@dataclass(frozen=True)
class GripperPoints:
    """Points on and in the open gripper.

    Attributes:
        xyz: (m, 3) float32, gripper frame (m).
        allowed: (m,) float32, depth of the nearest grid point up to which a point may be free (m).
    """

    xyz: NDArray[np.float32]
    allowed: NDArray[np.float32]

    @classmethod
    def of(cls, gripper: Gripper) -> GripperPoints:
        """Points of the collision surface, and those that lie deep enough in the gripper for any
        contact there to be a collision.
        """
        surface = gripper.collision_points(SURFACE_SPACING)[0]
        inner = [np.zeros((0, 3))]
        for vertices, faces in gripper.meshes("open", "collision"):
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            axes = [np.arange(a, b, INNER_SPACING) for a, b in zip(low, high, strict=True)]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
            normals = _normals(vertices, faces)
            depth = (vertices @ normals.T).max(axis=0) - points @ normals.T
            inner.append(points[depth.min(axis=1) > MAX_DEPTH + OFF_GRID])
        count = sum(map(len, inner))
        allowed = np.full(len(surface) + count, MAX_DEPTH + OFF_GRID)
        allowed[len(surface) :] = 0.0
        xyz = np.concatenate([surface, *inner])
        return cls(xyz.astype(np.float32), allowed.astype(np.float32))


def _shape(model: mujoco.MjModel, geom: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (v, 3) and outward unit face normals (f, 3) of a box or convex mesh, geom frame."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * model.geom_size[geom], np.concatenate([np.eye(3), -np.eye(3)])
    mesh = int(model.geom_dataid[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    start, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return vertices, _normals(vertices, model.mesh_face[start : start + number])


def _normals(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Outward unit normals (f, 3) of a convex mesh, each once."""
    a, b, c = vertices[faces.T]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-12] / length[length > 1e-12, None]
    return np.unique(np.round(normals, 6), axis=0)

"""Triangle meshes of a compiled model's geoms and their poses in a posture."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from megrasp_core.grippers.model import COLLISION_GROUP, VISUAL_GROUP

SECTIONS = 24


@dataclass(frozen=True)
class BodyMesh:
    """Mesh of one geom in the frame of its body: vertices (V, 3) in metres, faces (F, 3), the
    body's id.
    """

    body: int
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def body_meshes(model: mujoco.MjModel, which: str) -> list[BodyMesh]:
    """Return the meshes of all geoms, `which` is "visual" or "collision" (mesh geoms collide as
    convex hulls).
    """
    group = VISUAL_GROUP if which == "visual" else COLLISION_GROUP
    out = []
    for index in np.flatnonzero(model.geom_group == group):
        mesh = _geom_mesh(model, int(index), hull=which == "collision")
        if mesh is None:
            continue
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[index])
        vertices = np.asarray(mesh.vertices) @ rotation.reshape(3, 3).T + model.geom_pos[index]
        out.append(
            BodyMesh(int(model.geom_bodyid[index]), vertices, np.asarray(mesh.faces, np.int64))
        )
    return out


def body_poses(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return gripper_from_body (nbody, 4, 4) for joint positions (nq,); the model's root is the
    gripper frame.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    out = np.tile(np.eye(4), (model.nbody, 1, 1))
    out[:, :3, :3] = data.xmat.reshape(-1, 3, 3)
    out[:, :3, 3] = data.xpos
    return out


def posed(
    meshes: list[BodyMesh], poses: NDArray[np.float64]
) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return (vertices (V, 3), faces (F, 3)) of every mesh in the gripper frame."""
    return [(m.vertices @ poses[m.body, :3, :3].T + poses[m.body, :3, 3], m.faces) for m in meshes]


def _geom_mesh(model: mujoco.MjModel, index: int, hull: bool) -> trimesh.Trimesh | None:
    """Return the mesh of a geom in its own frame, None for kinds without a finite surface."""
    kind = mujoco.mjtGeom(int(model.geom_type[index]))
    size = model.geom_size[index]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _asset_mesh(model, int(model.geom_dataid[index]), hull)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(extents=2.0 * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=SECTIONS)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(
            height=2.0 * size[1], radius=size[0], count=[SECTIONS, SECTIONS]
        )
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return mesh
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        mesh.apply_scale(np.full(3, size[0]) if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size)
        return mesh
    return None


def _asset_mesh(model: mujoco.MjModel, mesh: int, hull: bool) -> trimesh.Trimesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    start, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    out = trimesh.Trimesh(vertices, model.mesh_face[start : start + number], process=False)
    return trimesh.Trimesh(vertices).convex_hull if hull else out

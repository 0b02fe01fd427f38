"""Triangle meshes of a compiled model's geoms and their poses in a posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.meshes import Mesh

from .model import COLLISION_GROUP, VISUAL_GROUP

SECTIONS = 24
GEOMETRY = (
    *(f"geom_{name}" for name in ("group", "type", "size", "pos", "quat", "bodyid", "dataid")),
    *(f"mesh_{name}" for name in ("vert", "vertadr", "vertnum", "face", "faceadr", "facenum")),
)


@dataclass(frozen=True)
class BodyMesh:
    """Mesh of one geom in the frame of its body, and the body's id."""

    body: int
    mesh: Mesh


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
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), model.geom_pos[index]
        out.append(BodyMesh(int(model.geom_bodyid[index]), mesh.moved(pose)))
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


def posed(meshes: Sequence[BodyMesh], poses: NDArray[np.float64]) -> list[Mesh]:
    """Return every mesh in the gripper frame."""
    return [one.mesh.moved(poses[one.body]) for one in meshes]


def geometry_arrays(model: mujoco.MjModel) -> list[NDArray]:
    """Return all of a model that its meshes are made from, for a hash of it."""
    return [getattr(model, name) for name in GEOMETRY]


def _geom_mesh(model: mujoco.MjModel, index: int, hull: bool) -> Mesh | None:
    """Return vertices and faces of a geom in its own frame, None for kinds without a finite
    surface.
    """
    kind = mujoco.mjtGeom(int(model.geom_type[index]))
    size = model.geom_size[index]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _asset_mesh(model, int(model.geom_dataid[index]), hull)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _capsule(float(size[0]), float(size[1]))
    scale = {
        mujoco.mjtGeom.mjGEOM_BOX: size,
        mujoco.mjtGeom.mjGEOM_CYLINDER: size[[0, 0, 1]],
        mujoco.mjtGeom.mjGEOM_SPHERE: size[[0, 0, 0]],
        mujoco.mjtGeom.mjGEOM_ELLIPSOID: size,
    }.get(kind)
    if scale is None:
        return None
    vertices, faces = _unit_mesh(kind)
    return Mesh(vertices * scale, faces)


@lru_cache
def _unit_mesh(kind: mujoco.mjtGeom) -> Mesh:
    """Return the mesh of a geom of size 1."""
    # Where clouds of a gripper are kept from before nobody needs its meshes: half a second less.
    import trimesh

    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=SECTIONS)
    else:
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))


@lru_cache(maxsize=256)
def _capsule(radius: float, half: float) -> Mesh:
    import trimesh

    mesh = trimesh.creation.capsule(height=2.0 * half, radius=radius, count=[SECTIONS, SECTIONS])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))


def _asset_mesh(model: mujoco.MjModel, mesh: int, hull: bool) -> Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    if hull:
        import trimesh

        convex = trimesh.Trimesh(vertices).convex_hull
        return Mesh(np.asarray(convex.vertices), np.asarray(convex.faces, np.int64))
    start, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return Mesh(vertices, model.mesh_face[start : start + number].astype(np.int64))

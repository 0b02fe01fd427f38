"""Puts table, bin, objects and gripper together into one MuJoCo model.

Settings and their reasons were measured: Newton, implicit-fast, 2 ms, elliptic cones with impratio
10 hold a grasped object without creep; a gripper welded straight to the world would lose MuJoCo's
parent-child contact filter, so it hangs on a free 1 kg "mount" body that a weld drags behind a
mocap body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .idle import lock
from .support import Bin, add_guard, add_support

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.objects import ObjectModel

GRIPPER_PREFIX = "gripper/"
VISUAL_GROUP = 2
COLLISION_GROUP = 3
GRIPPER_VISUAL_GROUP = 4
"""The gripper's visual geoms get a group of their own: the camera leaves it out."""

OBJECT_CONTYPE, OBJECT_CONAFFINITY = 1, 3
GRIPPER_CONTYPE, GRIPPER_CONAFFINITY = 2, 1
GUARD_CONTYPE = 4

CONTACT_SOLREF = (0.01, 1.0)
CONTACT_SOLIMP = (0.97, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of contacts among objects and support. MuJoCo's defaults let piles creep by 1 mm in
1.5 s and sink 0.9 mm into each other; these halve the creep, leave 0.1 mm, and settle in a
third of the time (fewer contacts, fewer retries).
"""

MOUNT_MASS = 1.0
GRIPPER_SOLMIX = 1000.0


@dataclass(frozen=True)
class Guard:
    """Tall walls used while settling: inner edges (x, y), lower end and height in m."""

    inner: tuple[float, float]
    bottom: float = 0.0
    height: float = 2.0


def set_options(spec: mujoco.MjSpec, timestep: float, gravity: bool) -> None:
    """Write the project's solver settings into `spec`."""
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    option.gravity = [0.0, 0.0, -9.81 if gravity else 0.0]


def _add_mesh(spec: mujoco.MjSpec, name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    mesh = spec.add_mesh(
        name=name,
        uservert=np.ascontiguousarray(vertices, dtype=np.float32).ravel(),
        userface=np.ascontiguousarray(faces, dtype=np.int32).ravel(),
    )
    # Body inertia is given, so the mesh's own is not used; the shell rule accepts open and flat
    # scans.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def add_object(
    spec: mujoco.MjSpec,
    index: int,
    model: ObjectModel,
    asset: str,
    *,
    new_asset: bool,
    friction: tuple[float, float, float],
    conaffinity: int,
    visual: bool,
) -> None:
    """Add free body "object_<index>", whose origin is the object's centre of mass.

    Args:
        spec: to add it to.
        index: number of the object.
        model: the object.
        asset: prefix of the mesh names, shared by equal objects.
        new_asset: whether to add the meshes.
        friction: sliding, torsional (m), rolling (m).
        conaffinity: bits of what it touches.
        visual: whether to add the visual mesh.
    """
    # gravcomp is not 0, because MuJoCo drops the term for good if no body has it at compile time.
    body = spec.worldbody.add_body(name=f"object_{index}", gravcomp=1.0)
    body.add_freejoint(name=f"object_{index}")
    inertia = np.asarray(model.inertia, dtype=np.float64)
    body.explicitinertial = True
    body.mass = float(model.mass)
    body.ipos = [0.0, 0.0, 0.0]
    body.fullinertia = [
        *np.diag(inertia).tolist(),
        float(inertia[0, 1]),
        float(inertia[0, 2]),
        float(inertia[1, 2]),
    ]
    colour = [*np.asarray(model.colour, dtype=np.float64).tolist(), 1.0]
    for piece, (vertices, faces) in enumerate(model.pieces):
        if new_asset:
            _add_mesh(spec, f"{asset}_piece_{piece}", vertices, faces)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{asset}_piece_{piece}",
            contype=OBJECT_CONTYPE,
            conaffinity=conaffinity,
            condim=4,
            friction=list(friction),
            solref=list(CONTACT_SOLREF),
            solimp=list(CONTACT_SOLIMP),
            group=COLLISION_GROUP,
            rgba=colour,
        )
    if visual:
        if new_asset:
            _add_mesh(spec, f"{asset}_visual", model.vertices, model.faces)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{asset}_visual",
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
            rgba=colour,
        )


def add_gripper(spec: mujoco.MjSpec, gripper: Gripper, *, locked: bool) -> None:
    """Attach the gripper to body "mount", dragged by mocap body "hand" through the weld "hand".

    The mount's frame is the gripper frame. Weight of mount and gripper is compensated, as an arm
    does. The gripper's geoms keep their own contact stiffness (weight `GRIPPER_SOLMIX`) but take
    friction from what they touch, so that one number, the object's, sets the friction of a trial.
    locked: whether joints that a grasp does not move are fixed.
    """
    model = gripper.spec()
    if locked:
        lock(model, gripper)
    spec.worldbody.add_body(name="hand", mocap=True)
    mount = spec.worldbody.add_body(name="mount", gravcomp=1.0)
    mount.add_freejoint(name="mount")
    mount.explicitinertial = True
    mount.mass = MOUNT_MASS
    mount.ipos = [0.0, 0.0, 0.0]
    mount.inertia = [0.002, 0.002, 0.002]
    spec.attach(model, prefix=GRIPPER_PREFIX, frame=mount.add_frame())
    weld = spec.add_equality(
        name="hand",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1="hand",
        name2="mount",
        solref=[0.004, 1.0],
        solimp=[0.98, 0.99, 0.001, 0.5, 2.0],
    )
    weld.data[:] = 0.0
    weld.data[6] = 1.0  # relative quaternion, w first
    weld.data[10] = 1.0  # torque scale
    for body in spec.bodies:
        if body.name.startswith(GRIPPER_PREFIX):
            body.gravcomp = 1.0
            for geom in body.geoms:
                _prepare_gripper_geom(geom)


def _prepare_gripper_geom(geom: mujoco.MjsGeom) -> None:
    if geom.contype == 0 and geom.conaffinity == 0:
        geom.group = GRIPPER_VISUAL_GROUP
        return
    geom.contype = GRIPPER_CONTYPE
    geom.conaffinity = GRIPPER_CONAFFINITY
    geom.condim = 4
    geom.priority = 0
    geom.solmix = GRIPPER_SOLMIX
    geom.friction = [0.0, 0.0, 0.0]
    geom.group = COLLISION_GROUP


def assemble(
    objects: Sequence[ObjectModel],
    *,
    gripper: Gripper | None,
    bin: Bin | None,
    table: bool,
    friction: float | None,
    timestep: float,
    gravity: bool,
    visual: bool,
    guard: Guard | None,
    locked: bool,
) -> mujoco.MjModel:
    """Compile the model of a world.

    Args:
        objects: bodies "object_0"..; equal ones share their meshes.
        gripper: a gripper that is moved by setting its pose; None: none.
        bin: on the table; None: the table alone.
        table: whether there is a support at all.
        friction: sliding friction of everything; None: each object's own, and 0.8 of the support.
        timestep: (s).
        gravity: whether it pulls.
        visual: whether to add the objects' visual meshes.
        guard: walls that keep falling objects in; None: none.
        locked: whether joints that the gripper's grasps do not move are fixed.

    Raises:
        ValueError: MuJoCo cannot compile it.
    """
    spec = mujoco.MjSpec()
    set_options(spec, timestep, gravity)
    sliding = 0.8 if friction is None else friction
    if table:
        add_support(
            spec,
            bin,
            contype=OBJECT_CONTYPE,
            conaffinity=OBJECT_CONAFFINITY,
            friction=(sliding, 0.01, 0.0001),
            solref=CONTACT_SOLREF,
            solimp=CONTACT_SOLIMP,
        )
    conaffinity = OBJECT_CONAFFINITY
    if guard is not None:
        add_guard(spec, guard.inner, guard.bottom, guard.height, contype=GUARD_CONTYPE)
        conaffinity |= GUARD_CONTYPE
    assets: dict[int, str] = {}
    for index, model in enumerate(objects):
        asset = assets.get(id(model))
        own_sliding = float(model.friction[0]) if friction is None else friction
        add_object(
            spec,
            index,
            model,
            asset or f"mesh_{index}",
            new_asset=asset is None,
            friction=(own_sliding, float(model.friction[1]), 0.0001),
            conaffinity=conaffinity,
            visual=visual,
        )
        assets.setdefault(id(model), f"mesh_{index}")
    if gripper is not None:
        add_gripper(spec, gripper, locked=locked)
    return spec.compile()

"""Units: models and meshes in millimetres are found by their size and brought to metres."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from megrasp_core.errors import DescriptionError

from .findings import Notes

LARGE = 3.0
"""No link of a gripper, nor a distance between two, is this long (m)."""

DOUBTFUL = 1.0
"""Where one mesh is in millimetres, others this long (m) are too."""

PLAUSIBLE = 0.5
"""Shapes or distances of a gripper that is in metres are shorter (m) than this."""

SMALL = 0.004
MILLIMETRE = 0.001
LEAST_EXPECTED, MOST_EXPECTED = 0.03, 1.5
"""Size (m) of the grippers that a guessed scale may lead to."""


def scale_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: Notes) -> bool:
    """Scale meshes that are in millimetres while the joints are in metres; return whether any.

    The meshes of one file set share their unit, but some models scale a few of them already.
    """
    extents = mesh_extents(model)
    largest = max(extents.values(), default=0.0)
    if largest < LARGE or largest * MILLIMETRE < LEAST_EXPECTED or _distances(model) >= LARGE:
        return False
    large = {name for name, extent in extents.items() if extent >= DOUBTFUL}
    for mesh in spec.meshes:
        if mesh.name in large:
            mesh.scale = np.asarray(mesh.scale) * MILLIMETRE
    notes.add(
        f"{len(large)} meshes are up to {largest:.0f} units long while the joints "
        "lie in metres: taken as millimetres and scaled by 0.001"
    )
    return True


def check_units(model: mujoco.MjModel, path: Path) -> float | None:
    """Return the scale that would make the model's lengths metres, None where they are.

    Raises:
        DescriptionError: too large or too small, and no common unit explains it.
    """
    apart, shapes = _distances(model), max([*mesh_extents(model).values(), _geom_size(model)])
    size = max(apart, shapes)
    if SMALL <= size < LARGE:
        return None
    _refuse_mixed(apart, shapes, path)
    if LEAST_EXPECTED <= size * MILLIMETRE <= MOST_EXPECTED:
        return MILLIMETRE
    raise DescriptionError(
        f"{path}: the model is {size:.3g} m large; expected a gripper of "
        f"{LEAST_EXPECTED:g} to {MOST_EXPECTED:g} m in metres. Say what one of its units is in "
        "metres: --scale 0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches"
    )


def _refuse_mixed(apart: float, shapes: float, path: Path) -> None:
    """Raise DescriptionError where shapes are in one unit and what places the links in another:
    scaling all lengths would then shrink the part that is right.
    """
    units = "0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches"
    if shapes >= LARGE and apart < PLAUSIBLE:
        raise DescriptionError(
            f"{path}: shapes are up to {shapes:.3g} units large while links lie at most "
            f"{apart:.3g} m apart; expected both in metres. Scale the meshes alone, in the model: "
            '<mesh filename="..." scale="0.01 0.01 0.01"/> in a URDF, scale="0.01 0.01 0.01" of '
            f"the <mesh> in an MJCF ({units}); --scale would shrink the joints as well"
        )
    if apart >= LARGE and shapes < PLAUSIBLE:
        raise DescriptionError(
            f"{path}: links lie up to {apart:.3g} units apart while shapes are at most "
            f"{shapes:.3g} m large; expected both in metres. Is it a scene, name the gripper's "
            "link: --root LINK. Else the origins of the joints (MJCF: pos) and the limits of "
            f"slides are in another unit: multiply them in the model ({units}); --scale would "
            "shrink the shapes as well"
        )


def scale_model(spec: mujoco.MjSpec, factor: float) -> None:
    """Scale every length of a model in place."""
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    sliding = {joint.name for joint in spec.joints if joint.type == slide}
    for mesh in spec.meshes:
        if mesh.file:
            mesh.scale = np.asarray(mesh.scale) * factor
        elif len(mesh.uservert):
            mesh.uservert = (np.asarray(mesh.uservert) * factor).tolist()
    for item in [*spec.bodies, *spec.geoms, *spec.joints, *spec.sites, *spec.frames]:
        if getattr(item, "name", "") != "world":
            item.pos = np.asarray(item.pos) * factor
    for item in [*spec.geoms, *spec.sites]:
        item.size = np.asarray(item.size) * factor
        item.fromto = np.asarray(item.fromto) * factor
    for body in spec.bodies:
        body.ipos = np.asarray(body.ipos) * factor
        body.inertia = np.asarray(body.inertia) * factor**2
        body.fullinertia = np.asarray(body.fullinertia) * factor**2
    for joint in spec.joints:
        if joint.name in sliding:
            joint.range = np.asarray(joint.range) * factor
            joint.ref *= factor
    for actuator in spec.actuators:
        if actuator.target in sliding:
            actuator.ctrlrange = np.asarray(actuator.ctrlrange) * factor


def mesh_extents(model: mujoco.MjModel) -> dict[str, float]:
    """Return mesh name -> longest edge of its bounding box (m)."""
    out = {}
    for index in range(model.nmesh):
        first, count = int(model.mesh_vertadr[index]), int(model.mesh_vertnum[index])
        vertices = model.mesh_vert[first : first + count]
        out[model.mesh(index).name] = float(np.ptp(vertices, axis=0).max())
    return out


def far_root(model: mujoco.MjModel) -> str | None:
    """Return the link that holds the whole model far from its origin, None where it is near: a
    gripper that is placed in a room belongs to no frame there.
    """
    if max([*mesh_extents(model).values(), _geom_size(model)]) >= LARGE:
        return None
    lead = _leading(model)
    far = [body for body in lead if np.abs(model.body_pos[body]).max() >= DOUBTFUL]
    return model.body(far[-1]).name if far else None


def _leading(model: mujoco.MjModel) -> list[int]:
    """Return the bodies, from the root on, that lead to all shapes and joints and have a place but
    nothing before them.
    """
    out, body = [], 0
    while not model.body_geomnum[body] and (body == 0 or not model.body_jntnum[body]):
        below = [b for b in range(1, model.nbody) if int(model.body_parentid[b]) == body]
        if len(below) != 1:
            break
        body = below[0]
        if model.body_jntnum[body]:
            break
        out.append(body)
    return out


def _distances(model: mujoco.MjModel) -> float:
    """Return the longest offset (m) of a body from its parent, beyond the place of all."""
    inner = np.setdiff1d(np.arange(model.nbody), _leading(model))
    return float(np.abs(model.body_pos[inner]).max(initial=0.0))


def _geom_size(model: mujoco.MjModel) -> float:
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    bounded = [g for g in range(model.ngeom) if int(model.geom_type[g]) != plane]
    return float(2.0 * model.geom_rbound[bounded].max(initial=0.0))

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
    size = max([_distances(model), *mesh_extents(model).values(), _geom_size(model)])
    if SMALL <= size < LARGE:
        return None
    if LEAST_EXPECTED <= size * MILLIMETRE <= MOST_EXPECTED:
        return MILLIMETRE
    raise DescriptionError(
        f"{path}: the model is {size:.3g} m large; expected a gripper of "
        f"{LEAST_EXPECTED:g} to {MOST_EXPECTED:g} m in metres. Say what one of its units is in "
        "metres: --scale 0.001 for millimetres, 0.01 for centimetres, 0.0254 for inches"
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


def _distances(model: mujoco.MjModel) -> float:
    return float(np.abs(model.body_pos).max(initial=0.0))


def _geom_size(model: mujoco.MjModel) -> float:
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    bounded = [g for g in range(model.ngeom) if int(model.geom_type[g]) != plane]
    return float(2.0 * model.geom_rbound[bounded].max(initial=0.0))

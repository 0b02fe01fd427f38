"""Masses and inertias that cannot be those of the body's geometry, replaced by plausible ones.

Files in circulation hold links of micrograms, inertias of a square metre times the mass, centres
of mass copied from another link. The drives' armature hides some of it, but a trial shakes the
whole gripper.
"""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from numpy.typing import NDArray

# Mass over the volume of the body's bounding box, kg/m3. Hollow links that lie oblique in their
# box have about 90; nothing solid is denser than 20 000.
DENSITY_RANGE = (30.0, 20000.0)
# Radius of gyration over half the diagonal of the box (most) and over its longest half side
# (least).
GYRATION_RANGE = (0.1, 1.2)
CENTRE_TOLERANCE = 0.01
THINNEST = 0.0005
# What a replaced mass is made from: a box partly full of aluminium and plastic, kg/m3.
DENSITY = 600.0

_log = logging.getLogger(__name__)


def correct_masses(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """Give bodies of `spec` with impossible mass properties those of a box around their geoms.

    Args:
        spec: the specification that was compiled, changed in place; compile it again if a name
            is returned.
        model: what it compiled to.

    Returns:
        Names of the changed bodies.
    """
    changed = []
    boxes = _bounding_boxes(model)
    for body in spec.bodies:
        if body.id not in boxes:
            continue
        low, high = boxes[body.id]
        centre, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, THINNEST)
        mass = float(model.body_mass[body.id])
        volume = 8.0 * float(np.prod(half))
        dense = DENSITY_RANGE[0] <= mass / volume <= DENSITY_RANGE[1]
        if dense and _inertia_fits(model, body.id, low, high):
            continue
        mass = mass if dense else DENSITY * volume
        body.explicitinertial = True
        body.mass, body.ipos, body.iquat = mass, centre, (1.0, 0.0, 0.0, 0.0)
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.fullinertia = np.full(6, np.nan)
        body.inertia = mass / 3.0 * ((half**2).sum() - half**2)
        changed.append(body.name)
    if changed:
        _log.info(
            "%s: impossible mass or inertia, replaced by that of a box: %s",
            spec.modelname,
            ", ".join(changed),
        )
    return changed


def _inertia_fits(
    model: mujoco.MjModel, body: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> bool:
    """Return whether centre and moments can be those of a body inside the box."""
    centre = model.body_ipos[body]
    if np.maximum(low - centre, centre - high).max() > CENTRE_TOLERANCE:
        return False
    half = (high - low) / 2.0
    gyration = float(np.sqrt(model.body_inertia[body].max() / model.body_mass[body]))
    least, most = GYRATION_RANGE
    return least * float(half.max()) <= gyration <= most * float(np.linalg.norm(half))


def _bounding_boxes(
    model: mujoco.MjModel,
) -> dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return body id -> lowest and highest corner (3,) of its geoms in the frame of the body."""
    corners = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]], indexing="ij"), axis=-1).reshape(-1, 3)
    out: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for geom in np.flatnonzero(model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE):
        body = int(model.geom_bodyid[geom])
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        local = model.geom_aabb[geom, :3] + corners * model.geom_aabb[geom, 3:]
        points = local @ rotation.reshape(3, 3).T + model.geom_pos[geom]
        low, high = points.min(axis=0), points.max(axis=0)
        if body in out:
            low, high = np.minimum(low, out[body][0]), np.maximum(high, out[body][1])
        out[body] = low, high
    return out

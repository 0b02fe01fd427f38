"""Shapes that are no part of a gripper: hulls around it, markers between its fingers."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from .findings import Notes
from .mechanism import Mechanism
from .motion import DriveMotion
from .solids import Solids

ENCLOSED = 0.5
"""A shape of the palm that holds this share of every finger's tip is a hull around the gripper."""

APART = 0.003
"""A link this far (m) from the rest of the palm is fastened to nothing."""

MARKER = 0.08
"""Longest edge (m) of a marker that may touch things."""

AROUND = 0.02
"""Markers lie so near (m) to the space of the fingers."""


def leave_out_foreign(
    spec: mujoco.MjSpec, mechanism: Mechanism, motion: DriveMotion, notes: Notes
) -> bool:
    """Delete hulls and markers from a model in place; return whether there were any.

    Args:
        spec: the model.
        mechanism: its structure, compiled as the loader compiles it.
        motion: its joints.
        notes: what was left out is written here.
    """
    # At the ends of their range fingers may stand anywhere, also in the palm.
    poses = motion.poses(motion.rest())
    middle = (motion.low + motion.high) / 2.0
    around = [poses, *(motion.poses(v) for v in (motion.low, middle, motion.high))]
    found = _hulls(spec, mechanism, poses, notes)
    return _markers(spec, mechanism, around, notes) or found


def _hulls(
    spec: mujoco.MjSpec,
    mechanism: Mechanism,
    poses: NDArray[np.float64],
    notes: Notes,
) -> bool:
    model = mechanism.model
    found = False
    left = Solids(model, mechanism.palm).count
    for body in mechanism.palm:
        name = model.body(body).name
        solids = Solids(model, [body])
        if not solids.count:
            continue
        inside = _enclosing(mechanism, poses, solids)
        if not inside.any() or left <= inside.sum():
            continue
        left -= int(inside.sum())
        own = spec.body(name)
        solid = [geom for geom in own.geoms if geom.contype or geom.conaffinity]
        bare = len(solid) == len(own.geoms)
        shown = [geom for geom in own.geoms if geom not in solid]
        gone = [geom for geom, away in zip(solid or shown, inside, strict=False) if away]
        seen = Solids(model, [body], seen=True)
        if solid and seen.count == len(shown):
            around = _enclosing(mechanism, poses, seen)
            gone += [geom for geom, away in zip(shown, around, strict=True) if away]
        for geom in gone:
            spec.delete(geom)
        found = True
        if bare and inside.all():
            what = f"link '{name}' has only collision geometry and encloses the fingers"
        else:
            what = f"link '{name}' has a shape that encloses the fingers"
        notes.add(f"{what} (a safety hull?): left out")
    return found


def _enclosing(
    mechanism: Mechanism, poses: NDArray[np.float64], solids: Solids
) -> NDArray[np.bool_]:
    """Which shapes (count,) hold a good part of every finger's tip."""
    shares = [
        solids.shares_inside(mechanism.surface(poses, branch.tip), poses)
        for branch in mechanism.branches
    ]
    return np.asarray(np.min(shares, axis=0) >= ENCLOSED)


def _markers(
    spec: mujoco.MjSpec,
    mechanism: Mechanism,
    postures: list[NDArray[np.float64]],
    notes: Notes,
) -> bool:
    model = mechanism.model
    leaves = [
        body
        for body in range(1, model.nbody)
        if body in mechanism.palm
        and not (model.body_parentid == body).any()
        and not int(model.body_jntnum[body])
        and (mechanism.owner == body).any()
    ]
    fingers = np.concatenate(
        [mechanism.surface(p, branch.bodies) for p in postures for branch in mechanism.branches]
    )
    low, high = fingers.min(axis=0) - AROUND, fingers.max(axis=0) + AROUND
    found = False
    for body in leaves:
        own = mechanism.surface(postures[0], [body])
        size = float(np.ptp(own, axis=0).max())
        if _only_seen(spec.body(model.body(body).name)):
            # Axes drawn at the TCP stand out of the fingers as far as they like.
            near = ((own.max(axis=0) > low) & (own.min(axis=0) < high)).all()
        else:
            centre = (own.min(axis=0) + own.max(axis=0)) / 2.0
            near = size <= MARKER and ((centre > low) & (centre < high)).all()
        if not near:
            continue
        rest = mechanism.surface(postures[0], [b for b in mechanism.palm if b != body])
        if not len(rest) or float(np.min(KDTree(rest).query(own)[0])) < APART:
            continue
        name = model.body(body).name
        for geom in list(spec.body(name).geoms):
            spec.delete(geom)
        notes.add(f"link '{name}' touches nothing of the palm (a marker?): left out")
        found = True
    return found


def _only_seen(body: mujoco.MjsBody) -> bool:
    return not any(geom.contype or geom.conaffinity for geom in body.geoms)

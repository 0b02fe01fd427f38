"""What a grasp does not need: joints that it does not move, geometry that touches nothing.

The wrist of a hand and fingers that stay folded are as far in the open posture as in the closed
one, and so are their commands. Where many trials are run, they are locked: the solver's time grows
with the cube of the moving joints. Visual geometry would be moved along in every step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

SAME = 1e-6
"""Positions (rad or m) and commands closer than this are equal."""


@dataclass(frozen=True)
class IdleParts:
    """What locking takes out of a gripper's model.

    Attributes:
        bodies: whose joints all stand still.
        joints: theirs.
        tendons: over these joints alone.
        actuators: of these joints and tendons, as indices of `Gripper.control`.
        equalities: between these joints, as indices.
    """

    bodies: frozenset[str] = frozenset()
    joints: frozenset[str] = frozenset()
    tendons: frozenset[str] = frozenset()
    actuators: frozenset[int] = frozenset()
    equalities: frozenset[int] = frozenset()


def idle_parts(gripper: Gripper) -> IdleParts:
    """Joints with equal positions and commands in both postures, and what hangs on them alone.

    A joint that something couples to a moving one is not idle, nor is one that shares its body
    with a moving one.
    """
    model = gripper.model
    opened, closed = gripper.posture("open"), gripper.posture("closed")
    names = [model.joint(j).name for j in range(model.njnt)]
    moved = {j for j in range(model.njnt) if abs(opened[names[j]] - closed[names[j]]) > SAME}
    driven = np.abs(gripper.control("open") - gripper.control("closed")) > SAME
    groups = [
        *_couplings(model),
        *(set(np.flatnonzero(model.jnt_bodyid == body).tolist()) for body in range(model.nbody)),
    ]
    moved |= {j for index in np.flatnonzero(driven) for j in _acted_on(model, int(index))}
    while True:
        dragged = {j for group in groups if group & moved for j in group} - moved
        if not dragged:
            break
        moved |= dragged
    idle = set(range(model.njnt)) - moved
    tendons = {t for t in range(model.ntendon) if (own := _wrapped(model, t)) and own <= idle}
    return IdleParts(
        bodies=frozenset(model.body(model.jnt_bodyid[j]).name for j in idle),
        joints=frozenset(names[j] for j in idle),
        tendons=frozenset(model.tendon(t).name for t in tendons),
        actuators=frozenset(
            i for i in range(model.nu) if (own := _acted_on(model, i)) and own <= idle
        ),
        equalities=frozenset(
            i for i in range(model.neq) if (own := _equated(model, i)) and own <= idle
        ),
    )


def lock(spec: mujoco.MjSpec, gripper: Gripper) -> None:
    """Take the idle parts out of `spec`, a fresh `gripper.spec()`, leaving their links as they
    stand, and the geometry that neither touches nor weighs anything.
    """
    parts = idle_parts(gripper)
    posture = gripper.posture("open")
    for body in spec.bodies:
        if body.name in parts.bodies:
            _stand(body, posture)
    doomed = [
        *(actuator for i, actuator in enumerate(spec.actuators) if i in parts.actuators),
        *(equality for i, equality in enumerate(spec.equalities) if i in parts.equalities),
        *(tendon for tendon in spec.tendons if tendon.name in parts.tendons),
        *(joint for joint in spec.joints if joint.name in parts.joints),
        *_weightless_visuals(spec),
    ]
    for element in doomed:
        spec.delete(element)


def _weightless_visuals(spec: mujoco.MjSpec) -> Iterable[mujoco.MjsGeom]:
    """Visual geoms of bodies whose inertia is written down and does not follow from them."""
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return
    for body in spec.bodies:
        if body.explicitinertial:
            yield from (geom for geom in body.geoms if not geom.contype and not geom.conaffinity)


def _stand(body: mujoco.MjsBody, posture: dict[str, float]) -> None:
    """Turn and move the body as its joints do in the posture (MuJoCo's order of joints)."""
    turn = Rotation.from_quat(np.roll(body.quat, -1))
    position = np.array(body.pos)
    for joint in body.joints:
        moved = posture[joint.name] - joint.ref
        axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            position = position + turn.apply(moved * axis)
            continue
        anchor = position + turn.apply(joint.pos)
        turn = turn * Rotation.from_rotvec(moved * axis)
        position = anchor - turn.apply(joint.pos)
    body.pos, body.quat = position, np.roll(turn.as_quat(), 1)


def _couplings(model: mujoco.MjModel) -> Iterable[set[int]]:
    yield from (_wrapped(model, tendon) for tendon in range(model.ntendon))
    yield from (_equated(model, index) for index in range(model.neq))


def _wrapped(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Joints that a fixed tendon runs over; none for a spatial one, which lets links stand."""
    start = model.tendon_adr[tendon]
    part = slice(start, start + model.tendon_num[tendon])
    return _ids(model.wrap_objid[part][model.wrap_type[part] == mujoco.mjtWrap.mjWRAP_JOINT])


def _equated(model: mujoco.MjModel, index: int) -> set[int]:
    kind = mujoco.mjtEq(model.eq_type[index])
    both = [int(i) for i in (model.eq_obj1id[index], model.eq_obj2id[index]) if i >= 0]
    if kind == mujoco.mjtEq.mjEQ_JOINT:
        return set(both)
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        return {joint for tendon in both for joint in _wrapped(model, tendon)}
    return set()


def _acted_on(model: mujoco.MjModel, actuator: int) -> set[int]:
    kind = mujoco.mjtTrn(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return {target}
    return _wrapped(model, target) if kind == mujoco.mjtTrn.mjTRN_TENDON else set()


def _ids(values: NDArray[np.int32]) -> set[int]:
    return {int(value) for value in values}

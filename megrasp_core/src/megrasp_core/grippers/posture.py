"""Postures: joint positions of a description checked and completed, controls settled in
simulation.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .actuation import control_of
from .description import GripperDescription, PostureDescription
from .fields import choices
from .model import quiet_mujoco

LIMIT_TOLERANCE = 1e-4
SETTLE_TIME = 2.0
REST_SPEED = 1e-4
SETTLE_DAMPING = 10.0


@dataclass(frozen=True)
class Posture:
    """A posture of the compiled model: all joint positions by name, qpos (nq,), control (nu,) that
    holds it.
    """

    joints: dict[str, float]
    qpos: NDArray[np.float64]
    control: NDArray[np.float64]


def resolve_posture(model: mujoco.MjModel, description: GripperDescription, name: str) -> Posture:
    """Return the posture "open" or "closed". Raises DescriptionError (unknown or missing joint,
    outside limits).
    """
    given: PostureDescription = getattr(description, name)
    where = f"{description.file}: 'postures.{name}"
    if given.joints is not None:
        qpos = _from_joints(model, given, where)
        control = control_of(model, qpos)
    else:
        control = _control(model, given, where)
        qpos = settle(model, control)
        if not np.isfinite(qpos).all():
            raise DescriptionError(
                f"{where}.actuators' is unstable in simulation; expected it to come to rest. "
                "Lower kp or add damping and armature in 'actuation'"
            )
    joints = {model.joint(i).name: float(qpos[model.jnt_qposadr[i]]) for i in range(model.njnt)}
    return Posture(joints, qpos, control)


def start_qpos(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Return the model's default positions (nq,) clipped to the joint limits, where a default may
    lie outside.
    """
    qpos = model.qpos0.copy()
    limited = model.jnt_limited.astype(bool)
    adr = model.jnt_qposadr[limited]
    qpos[adr] = np.clip(qpos[adr], *model.jnt_range[limited].T)
    return qpos


def settle(
    model: mujoco.MjModel,
    control: NDArray[np.float64],
    start: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Drive the gripper with `control` (nu,) until it rests, gravity compensated; return qpos, nan
    where it is unstable. `start` (nq,): from there, by default from `start_qpos`.

    Damping in proportion to inertia is added for this, so that models without any come to rest.
    """
    model = copy.copy(model)
    model.dof_damping += SETTLE_DAMPING * model.dof_M0
    data = mujoco.MjData(model)
    data.qpos[:] = start_qpos(model) if start is None else start
    data.ctrl[:] = control
    steps = int(SETTLE_TIME / model.opt.timestep)
    with quiet_mujoco():
        for step in range(steps):
            mujoco.mj_step(model, data)
            if step > steps // 10 and np.abs(data.qvel).max(initial=0.0) < REST_SPEED:
                break
    # MuJoCo starts an unstable state again at the default positions.
    unstable = any(int(warning.number) for warning in data.warning)
    return np.full(model.nq, np.nan) if unstable else data.qpos.copy()


def _from_joints(
    model: mujoco.MjModel, given: PostureDescription, where: str
) -> NDArray[np.float64]:
    names = [model.joint(i).name for i in range(model.njnt)]
    qpos = start_qpos(model)
    known: set[str] = set()
    for name, value in (given.joints or {}).items():
        if name not in names:
            raise DescriptionError(
                f"{where}.joints' names the joint '{name}', which the model does not have; "
                f"{choices('joints', name, names)}"
            )
        qpos[model.joint(name).qposadr[0]] = value
        known.add(name)
    _follow_couplings(model, qpos, known)
    missing = [name for name in names if name not in known]
    if missing:
        raise DescriptionError(
            f"{where}.joints' lacks the joint{'s' if len(missing) > 1 else ''} "
            f"{', '.join(missing)}; expected every joint that no joint coupling (mimic) derives, "
            f"or actuators instead; joints of the model: {', '.join(names)}"
        )
    for name in names:
        joint, value = model.joint(name), float(qpos[model.joint(name).qposadr[0]])
        low, high = joint.range
        if joint.limited[0] and not low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE:
            derived = "" if name in (given.joints or {}) else " through its coupling (mimic)"
            raise DescriptionError(
                f"{where}.joints.{name}' is {value:g}{derived}, outside the joint's limits; "
                f"expected {low:g} to {high:g}"
            )
    return qpos


def _follow_couplings(model: mujoco.MjModel, qpos: NDArray[np.float64], known: set[str]) -> None:
    """Fill in joints that a joint equality derives from known ones, in place, until nothing
    changes.
    """
    pairs = [
        i
        for i in range(model.neq)
        if model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[i]
    ]
    changed = True
    while changed:
        changed = False
        for i in pairs:
            first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
            poly = model.eq_data[i, :5]
            a = model.joint(first).name
            b = model.joint(second).name if second >= 0 else None
            offset_a = model.qpos0[model.jnt_qposadr[first]]
            if a not in known and (b is None or b in known):
                x = 0.0 if b is None else _offset(model, qpos, second)
                qpos[model.jnt_qposadr[first]] = offset_a + float(
                    np.polynomial.polynomial.polyval(x, poly)
                )
                known.add(a)
                changed = True
            elif (
                b is not None and a in known and b not in known and poly[1] and not poly[2:].any()
            ):
                x = (_offset(model, qpos, first) - poly[0]) / poly[1]
                qpos[model.jnt_qposadr[second]] = model.qpos0[model.jnt_qposadr[second]] + x
                known.add(b)
                changed = True


def _offset(model: mujoco.MjModel, qpos: NDArray[np.float64], joint: int) -> float:
    adr = model.jnt_qposadr[joint]
    return float(qpos[adr] - model.qpos0[adr])


def _control(model: mujoco.MjModel, given: PostureDescription, where: str) -> NDArray[np.float64]:
    names = [model.actuator(i).name for i in range(model.nu)]
    control = np.zeros(model.nu)
    if model.nu:
        low, high = model.actuator_ctrlrange.T
        limited = model.actuator_ctrllimited.astype(bool)
        control = np.where(limited, np.clip(control, low, high), control)
    for name, value in (given.actuators or {}).items():
        if name not in names:
            raise DescriptionError(
                f"{where}.actuators' names the actuator '{name}', which the model does not have; "
                f"{choices('actuators', name, names)}"
            )
        index = names.index(name)
        bottom, top = model.actuator_ctrlrange[index]
        if (
            model.actuator_ctrllimited[index]
            and not bottom - LIMIT_TOLERANCE <= value <= top + LIMIT_TOLERANCE
        ):
            raise DescriptionError(
                f"{where}.actuators.{name}' is {value:g}, outside the control range; expected "
                f"{bottom:g} to {top:g}"
            )
        control[index] = value
    return control

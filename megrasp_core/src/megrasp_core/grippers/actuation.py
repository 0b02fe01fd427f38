"""Drives: position actuators added to joints, drives of the model made stiffer, controls of a
posture.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .description import Actuation, GripperDescription
from .fields import choices


def apply_actuation(spec: mujoco.MjSpec, description: GripperDescription) -> None:
    """Add or replace the drives that `actuation` names. Raises DescriptionError for a name the
    model lacks.

    A key is a joint's name: the joint gets a position actuator of the same name, or, where the
    model already drives that joint by position, that actuator is changed. A drive of another kind
    (a motor, a controller plugin with a memory) is replaced: a posture could not be held by its
    control. A key may also be the name of an actuator of the model, for tendon drives.
    """
    joints = {joint.name: joint for joint in spec.joints}
    actuators = {actuator.name: actuator for actuator in spec.actuators if actuator.name}
    taken = set(actuators)
    for name, drive in description.actuation.items():
        if name in joints:
            joint = joints[name]
            joint.damping = _like(joint.damping, drive.damping)
            joint.armature = drive.armature
            # Friction that the force limit cannot overcome is a mistake of the file.
            if joint.frictionloss >= drive.force:
                joint.frictionloss = 0.0
            driving = [item for item in spec.actuators if _drives_joint(item, name)]
            for actuator in driving:
                if _by_position(actuator):
                    _restiffen(actuator, drive)
                else:
                    spec.delete(actuator)
            if not any(_drives_joint(item, name) for item in spec.actuators):
                _add_drive(spec, joint, drive, taken)
        elif name in actuators:
            _restiffen(actuators[name], drive)
        else:
            raise DescriptionError(
                f"{description.file}: 'actuation' names '{name}', which is no joint or actuator "
                f"of the model; {choices('joints', name, joints)}; "
                f"{choices('actuators', name, actuators)}"
            )
    for index, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or free_name(actuator.target or f"actuator_{index}", taken)


def control_of(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the control (nu,) whose position drives rest at the joint positions `qpos` (nq,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
    rest = -(bias[:, 0] + bias[:, 1] * data.actuator_length) / np.where(gain == 0.0, 1.0, gain)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = model.actuator_ctrlrange.T
    return np.where(limited, np.clip(rest, low, high), rest)


def _drives_joint(actuator: mujoco.MjsActuator, joint: str) -> bool:
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    return actuator.trntype in kinds and actuator.target == joint


def _by_position(actuator: mujoco.MjsActuator) -> bool:
    return not actuator.plugin.active and actuator.biasprm[1] < 0.0


def _add_drive(
    spec: mujoco.MjSpec, joint: mujoco.MjsJoint, drive: Actuation, taken: set[str]
) -> None:
    actuator = spec.add_actuator(
        name=free_name(joint.name, taken),
        target=joint.name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )
    actuator.gainprm[0] = drive.kp
    actuator.biasprm[:3] = (0.0, -drive.kp, 0.0)
    if joint.range[0] < joint.range[1] and joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE:
        actuator.ctrlrange = joint.range
        actuator.ctrllimited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
    _limit_force(actuator, drive)


def _restiffen(actuator: mujoco.MjsActuator, drive: Actuation) -> None:
    """Scale gain and stiffness alike, so that controls keep their meaning; limit the force."""
    stiffness = -actuator.biasprm[1]
    if stiffness > 0.0:
        factor = drive.kp / stiffness
        actuator.gainprm[0] *= factor
        actuator.biasprm[0] *= factor
        actuator.biasprm[1] = -drive.kp
        actuator.biasprm[2] = min(actuator.biasprm[2], -drive.damping)
    _limit_force(actuator, drive)


def _limit_force(actuator: mujoco.MjsActuator, drive: Actuation) -> None:
    actuator.forcelimited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
    actuator.forcerange = (-drive.force, drive.force)


def _like(current: object, value: float) -> object:
    """Return `value` in the shape MuJoCo's binding uses for a joint's damping (a number, or
    polynomial terms).
    """
    if isinstance(current, np.ndarray):
        out = np.zeros_like(current)
        out[0] = value
        return out
    return value


def free_name(wanted: str, taken: set[str]) -> str:
    """Return `wanted`, or with the first number that is free behind it, and add it to `taken`."""
    name, count = wanted, 1
    while name in taken:
        count += 1
        name = f"{wanted}_{count}"
    taken.add(name)
    return name

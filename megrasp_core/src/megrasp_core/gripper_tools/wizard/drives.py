"""What can be driven independently: actuators of the model, or the joints nothing else derives."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

HALF_TURN = np.pi / 2.0
"""Assumed limit (rad) either way of a hinge that the model leaves without limits."""

SLIDE_REACH = 0.05
"""Assumed limit (m) of a slide without limits."""

RANK_TOLERANCE = 1e-6

# MuJoCo's enumerations equal a model's integers only from one side, so plain integers.
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
TENDON_TRANSMISSION = int(mujoco.mjtTrn.mjTRN_TENDON)


@dataclass(frozen=True)
class Drive:
    """One independent drive of the gripper.

    `coefs` (njnt,): the driven length is their sum over joint positions (1 at one joint, several
    for a tendon). `low`, `high`: range of that length (m or rad). `actuator`: index in the model,
    -1 for a joint that has no actuator yet. `gain`, `offset`: control = gain * length + offset.
    """

    name: str
    coefs: NDArray[np.float64]
    low: float
    high: float
    actuator: int = -1
    gain: float = 1.0
    offset: float = 0.0

    @property
    def joints(self) -> list[int]:
        """Indices of the joints it pulls on."""
        return [int(i) for i in np.flatnonzero(self.coefs)]

    def control(self, length: float) -> float:
        """Return the actuator's control for a driven length."""
        return self.gain * length + self.offset


def joint_range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """Return the limits of a joint (rad or m): where the model has none, those that the joints
    that follow it give, else assumed ones.
    """
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint]
        return float(low), float(high)
    followed = _limits_of_followers(model, joint)
    if followed is not None:
        return followed
    reach = SLIDE_REACH if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else HALF_TURN
    return -reach, reach


def unlimited_joints(model: mujoco.MjModel) -> list[str]:
    """Return the names of independent joints without limits, their own or of what follows them."""
    followers = set(joint_followers(model))
    return [
        model.joint(i).name
        for i in range(model.njnt)
        if not model.jnt_limited[i]
        and i not in followers
        and _limits_of_followers(model, i) is None
    ]


def _limits_of_followers(model: mujoco.MjModel, joint: int) -> tuple[float, float] | None:
    """Return where the limited joints that follow a joint in proportion keep their limits, None
    without such joints or place.
    """
    low, high = -np.inf, np.inf
    chosen = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 == 1)
    for index in np.flatnonzero(chosen & (model.eq_obj2id == joint)):
        follower = int(model.eq_obj1id[index])
        offset, slope, *bent = model.eq_data[index, :5]
        if not model.jnt_limited[follower] or slope == 0.0 or np.any(bent):
            continue
        change = model.jnt_range[follower] - model.qpos0[model.jnt_qposadr[follower]] - offset
        ends = change / slope + model.qpos0[model.jnt_qposadr[joint]]
        low, high = max(low, float(ends.min())), min(high, float(ends.max()))
    return (low, high) if -np.inf < low < high < np.inf else None


def find_drives(model: mujoco.MjModel) -> list[Drive]:
    """Return the drives of a model, actuators first, in model order.

    Actuators that are no position servos (motors, plugins) count as none: what they move is driven
    at its joints.
    """
    drives = [
        drive for index in range(model.nu) if (drive := _actuator_drive(model, index)) is not None
    ]
    return drives + _joint_drives(model, drives)


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator holds a position that its control sets (no motor, no plugin)."""
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
    plain = int(model.actuator_plugin[actuator]) < 0
    return bool(affine and plain and model.actuator_biasprm[actuator, 1] < 0.0)


def joint_followers(model: mujoco.MjModel) -> dict[int, int]:
    """Return joint -> the joint that a joint equality (a mimic) derives it from, -1 for none."""
    chosen = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
    active = np.flatnonzero(chosen & (model.eq_active0 == 1))
    return {int(model.eq_obj1id[i]): int(model.eq_obj2id[i]) for i in active}


def transmission(model: mujoco.MjModel, actuator: int) -> NDArray[np.float64] | None:
    """Return the joint coefficients (njnt,) of an actuator on a joint or fixed tendon, or None."""
    coefs = np.zeros(model.njnt)
    target = int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    kind = int(model.actuator_trntype[actuator])
    if kind in JOINT_TRANSMISSIONS:
        coefs[target] = gear
    elif kind == TENDON_TRANSMISSION:
        first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
        for wrap in range(first, first + count):
            if model.wrap_type[wrap] != mujoco.mjtWrap.mjWRAP_JOINT:
                return None
            coefs[model.wrap_objid[wrap]] += gear * model.wrap_prm[wrap]
    else:
        return None
    return coefs


def _actuator_drive(model: mujoco.MjModel, index: int) -> Drive | None:
    coefs = transmission(model, index)
    if coefs is None or not is_servo(model, index):
        return None
    ends = np.array([joint_range(model, i) for i in range(model.njnt)])
    low, high = (float(v) for v in np.sort(coefs[:, None] * ends, axis=1).sum(axis=0))
    gain, offset = _control_of_length(model, index)
    if model.actuator_ctrllimited[index] and gain != 0.0:
        limits = (model.actuator_ctrlrange[index] - offset) / gain
        low, high = max(low, float(limits.min())), min(high, float(limits.max()))
    name = model.actuator(index).name
    return Drive(name, coefs, low, high, index, gain, offset)


def _control_of_length(model: mujoco.MjModel, index: int) -> tuple[float, float]:
    """Return (gain, offset) of control = gain * length + offset at which a servo rests."""
    gain = float(model.actuator_gainprm[index, 0]) or 1.0
    bias = model.actuator_biasprm[index]
    return float(-bias[1] / gain), float(-bias[0] / gain)


def _joint_drives(model: mujoco.MjModel, taken: list[Drive]) -> list[Drive]:
    """Return joints to drive directly: those whose motion no actuator and no coupling settles.

    A coupled set of joints that an actuator pulls on anywhere is left as it is, even where it has
    more freedoms than actuators: springs and stops rule those. So they do joints on springs beyond
    others that have none.
    """
    component = _components(model, taken)
    served = {component[j] for drive in taken for j in drive.joints}
    sprung = _on_springs(model, served, component)
    followers = joint_followers(model)
    rows = list(equality_jacobian(model))
    out = []
    order = sorted(range(model.njnt), key=lambda j: (j in followers, j))
    for joint in order:
        if component[joint] in served or joint in sprung:
            continue
        row = np.zeros(model.nv)
        row[model.jnt_dofadr[joint]] = 1.0
        if _rank([*rows, row]) == _rank(rows):
            continue
        rows.append(row)
        coefs = np.zeros(model.njnt)
        coefs[joint] = 1.0
        low, high = joint_range(model, joint)
        out.append(Drive(model.joint(joint).name, coefs, low, high))
    return sorted(out, key=lambda drive: drive.joints[0])


def _on_springs(model: mujoco.MjModel, served: set[int], component: list[int]) -> set[int]:
    """Return the joints that only a spring moves: stiff ones, coupled to none, further out than
    one that is driven.
    """
    alone = {j for j in range(model.njnt) if component.count(component[j]) == 1}
    stiff = {j for j in alone if model.jnt_stiffness[j] > 0.0 and component[j] not in served}
    out = set()
    for joint in stiff:
        body = int(model.body_parentid[model.jnt_bodyid[joint]])
        while body:
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            if any(j not in stiff for j in range(first, first + count)):
                out.add(joint)
                break
            body = int(model.body_parentid[body])
    return out


def _rank(rows: list[NDArray[np.float64]]) -> int:
    return int(np.linalg.matrix_rank(np.array(rows), tol=RANK_TOLERANCE)) if rows else 0


def equality_jacobian(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Return the Jacobian (rows, nv) of the active equalities at the model's default positions."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    count = int(data.ne)
    if not count:
        return np.zeros((0, model.nv))
    full = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(
            full, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
        )
    else:
        full[:] = data.efc_J.reshape(data.nefc, model.nv)
    return full[:count]


def _components(model: mujoco.MjModel, drives: list[Drive]) -> list[int]:
    """Return the component (njnt,) of every joint: joints linked by equalities and tendons."""
    parent = list(range(model.njnt))

    def find(joint: int) -> int:
        while parent[joint] != joint:
            joint = parent[joint]
        return joint

    def link(joints: list[int]) -> None:
        for joint in joints[1:]:
            parent[find(joint)] = find(joints[0])

    of_dof = model.dof_jntid
    for row in equality_jacobian(model):
        link([int(of_dof[dof]) for dof in np.flatnonzero(np.abs(row) > RANK_TOLERANCE)])
    for drive in drives:
        link(drive.joints)
    return [find(joint) for joint in range(model.njnt)]

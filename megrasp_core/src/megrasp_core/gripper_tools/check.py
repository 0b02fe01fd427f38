"""The full check of a gripper folder, as `megrasp gripper check` runs it."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import POSTURES, Gripper, quiet_mujoco
from megrasp_core.grippers.geometry import posed
from megrasp_core.meshes import RayScene
from megrasp_core.ranking import gripper_probe

from .compare import PAD_HALF_HEIGHT, opening, pad_displacement
from .symmetry import WARNING_RESIDUAL, symmetry_residual

CLOSING_TIME = 0.6
TIMESTEPS = (0.002, 0.004)
POSITION_SHARE = 0.05
WIDTH_TOLERANCE = 0.002
PALM_OVERLAP = 0.001
COUPLING_TOLERANCE = 0.002
"""Metres or radians that a given posture may be off a coupling or a closed loop of the model."""


LEAST_OPENING = 0.005
"""Grippers that open less (m) pick up nothing."""

SAME_POSTURE = 1e-6


@dataclass
class GripperCheck:
    """Result of a check: errors make the gripper unusable, warnings do not; measures are in
    metres.
    """

    name: str
    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    measures: dict[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not self.errors


def check_gripper(path: str | Path) -> GripperCheck:
    """Run every check on a gripper folder: description, model, frames, geometry, closing in
    simulation.
    """
    with quiet_mujoco():
        try:
            gripper = Gripper.from_path(path)
        except DescriptionError as error:
            return GripperCheck(str(path), errors=[str(error)])
        return find_mistakes(gripper)


def find_mistakes(gripper: Gripper) -> GripperCheck:
    """Run every check on a loaded gripper: all that `megrasp gripper new` and `megrasp gripper
    check` have to say about it.
    """
    result = check_geometry(gripper)
    if result.ok and gripper_probe(gripper).volume is None:
        result.errors.append(
            "no finger surfaces face each other along X and close; expected the closing axis "
            "along X: correct mount_from_model, or the open posture, so that the pads look at "
            "each other"
        )
    _check_couplings(gripper, result)
    with quiet_mujoco():
        for timestep in TIMESTEPS:
            _check_closing(gripper, result, timestep)
    residual = symmetry_residual(gripper)
    result.measures["symmetry_residual"] = residual
    if residual > WARNING_RESIDUAL:
        result.warnings.append(
            f"symmetry {gripper.description.symmetry}: the open gripper differs from itself "
            f"after the turn by {1000 * residual:.1f} mm (95th percentile); expected at most "
            f"{1000 * WARNING_RESIDUAL:.0f} mm"
        )
    return result


def check_geometry(gripper: Gripper) -> GripperCheck:
    """Check TCP, sides of the fingers, direction of their motion, width; without simulation."""
    result = GripperCheck(gripper.name)
    _check_geometry(gripper, result)
    return result


def _check_geometry(gripper: Gripper, result: GripperCheck) -> None:
    description = gripper.description
    difference = np.abs(gripper.qpos("open") - gripper.qpos("closed")).max(initial=0.0)
    if difference < SAME_POSTURE:
        result.errors.append(
            "the open and the closed posture are the same; expected two between which the fingers "
            "close"
        )
        return
    if not gripper.model.nu:
        result.errors.append(
            "no joint has a drive; expected at least one, name the joints to drive in 'actuation'"
        )
    solid = gripper.finger_groups[[mesh.body for mesh in gripper.body_meshes("collision")]]
    bare = [index for index in range(len(description.fingers)) if index not in solid]
    for index in bare:
        result.errors.append(
            f"finger group {index + 1} ({', '.join(description.fingers[index])}) has no collision "
            "geometry; expected some, or it cannot grasp in simulation: `megrasp gripper new` "
            "takes the visual shapes"
        )
    if bare or not (_palm_is_behind(gripper, result) and _fingers_reach(gripper, result)):
        return
    x = [_place_along_x(gripper, group) for group in (0, 1)]
    if x[0] >= x[1]:
        result.errors.append(
            f"finger group 1 lies at x = {x[0]:.3f} m, group 2 at {x[1]:.3f} m; expected the "
            "first group on -X: swap the groups in 'fingers' or correct mount_from_model"
        )
    elif not x[0] < gripper.tcp[0] < x[1]:
        result.errors.append(
            f"the TCP lies at x = {gripper.tcp[0]:.3f} m; expected it between finger group 1 at "
            f"{x[0]:.3f} m and group 2 at {x[1]:.3f} m"
        )
    moved = [pad_displacement(gripper, group) for group in (0, 1)]
    for group, step in enumerate(moved):
        result.measures[f"pad_closing_{group + 1}"] = float(step[0])
        result.measures[f"pad_forward_{group + 1}"] = float(step[2])
    approaching = float(moved[0][0] - moved[1][0])
    if not approaching > 0.0:
        result.errors.append(
            "from open to closed the pads approach each other by "
            f"{round(1000 * approaching, 1) + 0.0:.1f} mm along X; expected more than 0: correct "
            "the postures, or mount_from_model so that it brings the closing axis to X"
        )
    width = opening(gripper)
    result.measures["opening"] = width
    widest = width if np.isfinite(width) else description.max_width
    if widest is not None and widest < LEAST_OPENING:
        result.errors.append(
            f"the open fingers leave {1000 * widest:.1f} mm between them at the TCP; expected at "
            f"least {1000 * LEAST_OPENING:.0f} mm: correct the open posture"
        )
    if (
        description.max_width is not None
        and np.isfinite(width)
        and width < description.max_width - WIDTH_TOLERANCE
    ):
        result.warnings.append(
            f"max_width is {1000 * description.max_width:.1f} mm, but the open fingers leave "
            f"{1000 * width:.1f} mm at the TCP; expected no more than they leave"
        )


def _place_along_x(gripper: Gripper, group: int) -> float:
    """Return the mean x (m) of an open finger group, of its part at the TCP's height where it has
    one: a fixed jaw's group is the whole palm.
    """
    points = gripper.pad_points("open", group)
    level = np.abs(points[:, 2] - gripper.tcp[2]) < PAD_HALF_HEIGHT
    return float(points[level if level.any() else slice(None), 0].mean())


def _palm_is_behind(gripper: Gripper, result: GripperCheck) -> bool:
    """Check that the TCP lies neither inside nor behind the palm."""
    palm = [m for m in gripper.body_meshes("collision") if gripper.finger_groups[m.body] < 0]
    poses = gripper.body_poses("open")
    ray = np.array([[*gripper.tcp, 0.0, 0.0, 1.0]], np.float32)
    for mesh in palm:
        hit = RayScene(posed([mesh], poses)).cast(ray).distance[0]
        if np.isfinite(hit) and hit > PALM_OVERLAP:
            result.errors.append(
                f"the palm (link '{gripper.model.body(mesh.body).name}') lies in front of the "
                f"TCP {gripper.tcp.tolist()}; expected the TCP in front of the palm along +Z: "
                "correct tcp or mount_from_model"
            )
            return False
    return True


def _fingers_reach(gripper: Gripper, result: GripperCheck) -> bool:
    """Check that both groups get to the height of the TCP, a wide open hand's while it closes."""
    z = gripper.tcp[2]
    for group in (0, 1):
        height = np.concatenate([gripper.pad_points(name, group)[:, 2] for name in POSTURES])
        if np.abs(height - z).min() >= PAD_HALF_HEIGHT:
            result.errors.append(
                f"finger group {group + 1} spans z = {height.min():.3f} to {height.max():.3f} m, "
                f"open and closed, but the TCP lies at {z:.3f} m; expected it between the "
                "fingertips: correct tcp or mount_from_model"
            )
            return False
    return True


def _check_couplings(gripper: Gripper, result: GripperCheck) -> None:
    """Check that postures given as joints agree with the model's couplings and closed loops."""
    data = mujoco.MjData(gripper.model)
    for name in POSTURES:
        if getattr(gripper.description, name).joints is None:
            continue
        data.qpos[:] = gripper.qpos(name)
        mujoco.mj_forward(gripper.model, data)
        rows = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        off = float(np.abs(data.efc_pos[rows]).max(initial=0.0))
        if off > COUPLING_TOLERANCE:
            result.warnings.append(
                f"posture '{name}' is {off:.4f} (m or rad) off a joint coupling or closed loop of "
                "the model; expected joint values that fit it, or use actuators"
            )


def _check_closing(gripper: Gripper, result: GripperCheck, timestep: float) -> None:
    """Close on nothing for 0.6 s and compare the joints with the closed posture."""
    model = copy.copy(gripper.model)
    model.opt.timestep = timestep
    data = mujoco.MjData(model)
    data.qpos[:] = gripper.qpos("open")
    data.ctrl[:] = gripper.control("closed")
    for _ in range(round(CLOSING_TIME / timestep)):
        mujoco.mj_step(model, data)
    unstable = any(int(warning.number) for warning in data.warning)
    if unstable or not np.isfinite(data.qpos).all():
        result.errors.append(
            f"closing is unstable in simulation at timestep {timestep:g} s; expected it to come "
            "to rest: lower kp or add damping and armature in 'actuation'"
        )
        return
    span = np.maximum(np.abs(gripper.qpos("closed") - gripper.qpos("open")).max(initial=0.0), 1e-6)
    error = np.abs(data.qpos - gripper.qpos("closed"))
    worst = int(np.argmax(error)) if len(error) else 0
    result.measures[f"closing_error_{round(1000 * timestep)}ms"] = float(error[worst] / span)
    if error[worst] > POSITION_SHARE * span:
        joint = model.joint(int(np.flatnonzero(model.jnt_qposadr == worst)[0])).name
        result.warnings.append(
            f"after {CLOSING_TIME:g} s of closing on nothing (timestep {timestep:g} s) joint "
            f"'{joint}' is at {data.qpos[worst]:.4g}, the closed posture says "
            f"{gripper.qpos('closed')[worst]:.4g}; expected it to get there: give it a drive in "
            "'actuation', or more kp, force or damping"
        )

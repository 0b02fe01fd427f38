"""The full check of a gripper folder, as `megrasp gripper check` runs it."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import open3d as o3d

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers.compare import opening, pad_displacement
from megrasp_core.grippers.gripper import Gripper
from megrasp_core.grippers.render import raycasting_scene
from megrasp_core.grippers.symmetry import WARNING_RESIDUAL, symmetry_residual

CLOSING_TIME = 0.6
TIMESTEPS = (0.002, 0.004)
POSITION_SHARE = 0.05
WIDTH_TOLERANCE = 0.002
PALM_OVERLAP = 0.001


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
    try:
        gripper = Gripper.from_path(path)
    except DescriptionError as error:
        return GripperCheck(str(path), errors=[str(error)])
    result = GripperCheck(gripper.name)
    _check_geometry(gripper, result)
    for timestep in TIMESTEPS:
        _check_closing(gripper, result, timestep)
    residual = symmetry_residual(gripper)
    result.measures["symmetry_residual"] = residual
    if residual > WARNING_RESIDUAL:
        result.warnings.append(
            f"symmetry {gripper.description.symmetry}: the open gripper differs from itself "
            "after the turn by "
            f"{1000 * residual:.1f} mm (95th percentile), more than "
            f"{1000 * WARNING_RESIDUAL:.0f} mm"
        )
    return result


def _check_geometry(gripper: Gripper, result: GripperCheck) -> None:
    """Check sides of the fingers, direction of their motion, width, TCP; needs both kinds of
    geoms.
    """
    description = gripper.description
    if not gripper.body_meshes("collision"):
        result.errors.append(
            "the model has no collision geometry, so it cannot grasp in simulation"
        )
        return
    if not gripper.model.nu:
        result.errors.append("no joint has a drive; name the joints to drive in 'actuation'")
    _check_tcp(gripper, result)
    sides = [gripper.pad_points("open", group)[:, 0].mean() - gripper.tcp[0] for group in (0, 1)]
    if sides[0] >= sides[1]:
        result.errors.append(
            f"finger group 1 lies at x = {sides[0]:.3f} m, group 2 at {sides[1]:.3f} m; the "
            "first group must be on -X: "
            "swap the groups in 'fingers' or correct mount_from_model"
        )
    moved = [pad_displacement(gripper, group) for group in (0, 1)]
    for group, step in enumerate(moved):
        result.measures[f"pad_closing_{group + 1}"] = float(step[0])
        result.measures[f"pad_forward_{group + 1}"] = float(step[2])
    approaching = float(moved[0][0] - moved[1][0])
    if not approaching > 0.0:
        result.errors.append(
            f"from open to closed the pads approach each other by {1000 * approaching:.1f} mm "
            "along X; expected more "
            "than 0: check the postures and that mount_from_model brings the closing axis to X"
        )
    width = opening(gripper)
    result.measures["opening"] = width
    if (
        description.max_width is not None
        and np.isfinite(width)
        and width < description.max_width - WIDTH_TOLERANCE
    ):
        result.warnings.append(
            f"max_width is {1000 * description.max_width:.1f} mm, but the open fingers leave "
            f"{1000 * width:.1f} mm at the TCP"
        )


def _check_tcp(gripper: Gripper, result: GripperCheck) -> None:
    """Check that the TCP is not inside the open gripper and not behind the palm."""
    palm = [m for m in gripper.body_meshes("collision") if gripper.finger_groups[m.body] < 0]
    poses = gripper.body_poses("open")
    ray = np.array([[*gripper.tcp, 0.0, 0.0, 1.0]], np.float32)
    for mesh in palm:
        vertices = mesh.vertices @ poses[mesh.body, :3, :3].T + poses[mesh.body, :3, 3]
        hit = (
            raycasting_scene([(vertices, mesh.faces)])
            .cast_rays(o3d.core.Tensor.from_numpy(ray))["t_hit"]
            .numpy()[0]
        )
        if np.isfinite(hit) and hit > PALM_OVERLAP:
            result.errors.append(
                f"the palm (body '{gripper.model.body(mesh.body).name}') lies in front of the "
                f"TCP {gripper.tcp.tolist()}; "
                "expected the TCP in front of the palm along +Z"
            )
            return


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
            f"closing is unstable in simulation at timestep {timestep:g} s; add damping or "
            "armature"
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
            f"'{joint}' is at "
            f"{data.qpos[worst]:.4g}, the closed posture says {gripper.qpos('closed')[worst]:.4g}"
        )

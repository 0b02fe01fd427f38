"""From an analysis to a gripper.yaml that the strict loader accepts."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.gripper_tools.compare import opening
from megrasp_core.gripper_tools.symmetry import symmetry_residual
from megrasp_core.grippers import Actuation, Gripper, GripperDescription, Pose, PostureDescription

from .analyse import Analysis
from .drives import Drive, joint_followers
from .fingers import joint_gains
from .mechanism import palm_centre
from .prepare import MODEL_FILE, Prepared

SLIDE_DRIVE = Actuation(kp=10_000.0, force=40.0, damping=50.0, armature=0.1)
JAW_DRIVE = Actuation(kp=60.0, force=5.0, damping=0.5, armature=0.01)
HAND_DRIVE = Actuation(kp=10.0, force=1.0, damping=0.2, armature=0.001)
"""Drives for joints that have none in the model: what holds light objects without shaking."""

LEAST_WIDTH = 1e-3
LEAST_HEIGHT = 0.01
"""The TCP lies at least so far (m) before the gripper's origin; else the origin is moved."""

SYMMETRIC = 0.01
"""Real two-finger grippers differ from themselves after half a turn by up to this (m)."""

DIGITS = 6


@dataclass(frozen=True)
class Labels:
    """Names and words that only the user knows."""

    name: str
    display_name: str
    licence: str
    source: str


def compose(prepared: Prepared, analysis: Analysis, labels: Labels) -> GripperDescription:
    """Return the description of the model in `prepared.folder`."""
    rotation = analysis.axes.rotation()
    shift = _shift(prepared, analysis, rotation)
    tcp = np.round(rotation @ analysis.tcp + shift, 5)
    description = GripperDescription(
        name=labels.name,
        display_name=labels.display_name,
        kind=analysis.kind,
        model=MODEL_FILE,
        mount_from_model=_pose(rotation, shift),
        tcp=(float(tcp[0]), float(tcp[1]), float(tcp[2])),
        open=_posture(prepared, analysis.opposition.open),
        closed=_posture(prepared, analysis.opposition.closed),
        actuation=_actuation(prepared, analysis),
        max_width=None if analysis.hand else 1.0,
        min_width=0.0,
        fingers=_fingers(prepared.model, analysis),
        symmetry=1,
        licence=labels.licence,
        source=labels.source,
        folder=prepared.folder,
    )
    return _measured(description, analysis)


def valid_name(text: str) -> str:
    """Return the text as a gripper's name: a-z, 0-9 and _."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_") or "gripper"


def _pose(rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> Pose:
    quat = np.round(Rotation.from_matrix(rotation).as_quat(canonical=True), 8) + 0.0
    xyz = np.round(shift, 5) + 0.0
    x, y, z, w = (float(v) for v in quat)
    return Pose((float(xyz[0]), float(xyz[1]), float(xyz[2])), (x, y, z, w))


def _shift(
    prepared: Prepared, analysis: Analysis, rotation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where the model's origin lies in the gripper frame: 0 unless the TCP were behind."""
    if float(analysis.tcp @ analysis.axes.approach) >= LEAST_HEIGHT:
        return np.zeros(3)
    poses = prepared.motion.poses(analysis.opposition.open)
    palm = prepared.mechanism.surface(poses, prepared.mechanism.palm)
    centre = palm_centre(prepared.mechanism, poses)
    approach = analysis.axes.approach
    back = float((palm @ approach).min()) if len(palm) else float(centre @ approach)
    origin = centre + (back - float(centre @ approach)) * approach
    return -rotation @ origin


def _posture(prepared: Prepared, lengths: NDArray[np.float64]) -> PostureDescription:
    """Return joints where couplings follow from them, else controls, which the loader settles."""
    motion, model = prepared.motion, prepared.model
    if motion.simulated:
        controls = {}
        for drive, length in zip(motion.drives, lengths, strict=True):
            controls[drive.name] = _within(drive.control(float(length)), _control_range(drive))
        return PostureDescription(actuators=controls)
    qpos = motion.qpos(lengths)
    followers = joint_followers(model)
    joints = {}
    for joint in range(model.njnt):
        if joint in followers:
            continue
        value = float(qpos[model.jnt_qposadr[joint]])
        low, high = motion.ranges[joint]
        joints[model.joint(joint).name] = _within(value, (float(low), float(high)))
    return PostureDescription(joints=joints)


def _control_range(drive: Drive) -> tuple[float, float]:
    ends = sorted((drive.control(drive.low), drive.control(drive.high)))
    return ends[0], ends[1]


def _within(value: float, ends: tuple[float, float]) -> float:
    """Return a value rounded for a file, still within its range."""
    return float(np.clip(round(value, DIGITS), *ends)) + 0.0


def _actuation(prepared: Prepared, analysis: Analysis) -> dict[str, Actuation]:
    out = {}
    gains = joint_gains(prepared.motion)
    for index, drive in enumerate(prepared.motion.drives):
        if drive.actuator >= 0:
            continue
        slide = prepared.model.jnt_type[drive.joints[0]] == mujoco.mjtJoint.mjJNT_SLIDE
        driven = [f for f in analysis.fingers if index in f.curl]
        turn = HAND_DRIVE if analysis.hand else JAW_DRIVE
        if not slide and driven and all(f.sliding and len(f.moving) == 1 for f in driven):
            turn = _geared(max(abs(float(gains[index, f.moving[0]])) for f in driven))
        out[drive.name] = SLIDE_DRIVE if slide else turn
    return out


def _geared(gain: float) -> Actuation:
    """Return the drive of a hinge that acts on slides, `gain` m per rad, as theirs would."""
    full = SLIDE_DRIVE
    values = (
        full.kp * gain**2, full.force * gain, full.damping * gain**2, full.armature * gain**2
    )  # fmt: skip
    return Actuation(*(float(f"{value:.4g}") for value in values))


def _fingers(model: mujoco.MjModel, analysis: Analysis) -> tuple[tuple[str, ...], ...]:
    """Return both groups as the topmost links; what hangs from them belongs to them."""
    groups = []
    for group, fixed in zip(analysis.opposition.groups, analysis.opposition.fixed, strict=True):
        bodies = {body for finger in group for body in finger.bodies} | set(fixed)
        top = [body for body in sorted(bodies) if int(model.body_parentid[body]) not in bodies]
        groups.append(tuple(model.body(body).name for body in top))
    return tuple(groups)


def _measured(description: GripperDescription, analysis: Analysis) -> GripperDescription:
    """Fill in widths and symmetry, measured on the loaded gripper."""
    gripper = Gripper(description)
    out = description
    if not analysis.hand:
        wide, narrow = (
            _width(opening(gripper, posture), pad.room if pad is not None else None)
            for posture, pad in zip(("open", "closed"), analysis.pads, strict=True)
        )
        wide = max(wide, LEAST_WIDTH)
        narrow = 0.0 if analysis.opposition.contact else min(narrow, 0.99 * wide)
        out = replace(out, max_width=round(wide, 4), min_width=round(narrow, 4))
    if analysis.hand or len(analysis.fingers) < 2:
        return out
    for order in (len(analysis.fingers), 2):
        if symmetry_residual(gripper, order) < SYMMETRIC:
            return replace(out, symmetry=order)
    return out


def _width(measured: float, pads: float | None) -> float:
    """Return the clear width: rays at the TCP, where they miss the fingers the pads' room."""
    if np.isfinite(measured):
        return measured
    return max(pads or 0.0, 0.0)

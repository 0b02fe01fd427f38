"""Arms that carry no gripper: their last link is told from a single jaw, and refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .drives import unlimited_joints
from .fingers import Finger, joint_axes
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition

WRIST_RANGE = np.pi
"""A joint that turns farther (rad) is a wrist, not the hinge of a jaw on an arm."""

BACKWARDS = -0.3
"""A jaw points away from its arm: its approach has this cosine or more to the way to its hinge."""


def refuse_wrist(motion: DriveMotion, finger: Finger, carried: int) -> None:
    """Raise DescriptionError where the only part that moves, on a hinge, turns as no jaw does.

    Args:
        motion: its joints.
        finger: the only finger.
        carried: joints that lead to the palm.
    """
    drive = motion.drives[finger.curl[0]]
    if set(unlimited_joints(motion.model)) & {motion.model.joint(j).name for j in drive.joints}:
        raise no_gripper(finger, carried, "turns without limits")
    if drive.high - drive.low > WRIST_RANGE:
        turn = np.degrees(drive.high - drive.low)
        raise no_gripper(finger, carried, f"turns by {turn:.0f} degrees")


def refuse_backwards(
    mechanism: Mechanism,
    motion: DriveMotion,
    opposition: Opposition,
    approach: NDArray[np.float64],
    finger: Finger,
    carried: int,
) -> None:
    """Raise DescriptionError where the only finger closes against the arm that carries it."""
    hinge = joint_axes(motion, opposition.open)[0][finger.moving[0]]
    ahead = hinge - motion.poses(opposition.open)[mechanism.palm[0], :3, 3]
    size = float(np.linalg.norm(ahead))
    if float(ahead @ approach) < BACKWARDS * size:
        raise no_gripper(finger, carried, "closes backwards, against what carries it")


def no_gripper(finger: Finger, carried: int, why: str) -> DescriptionError:
    """Return the error for an arm whose last link is taken as the only finger."""
    return DescriptionError(
        f"no gripper found: {carried} joints lead to the last link that moves, '{finger.name}', "
        f"and it {why}. An arm alone, or are the fingers fixed joints? Expected two links that "
        "close, or one that closes against its base: give the gripper's model or that of the arm "
        "with it, its finger joints movable. A single jaw is believed with both postures: --open "
        "joint=value ... --closed joint=value ..."
    )

"""The postures that a search may try: a few directions in which a hand's joints vary together.

Joints that do the same in the fingers of one group share a direction, so that a hand of twenty
joints has some eight, each with one offset for the open and one for the closed posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper, GripperDescription, PostureDescription

POSTURES = ("open", "closed")
SAME_PLACE = 0.005
"""Fingers whose roots differ by less along Y count as one in the middle (m)."""
CHANGED = 0.5
"""Share of the offsets that a drawn variant changes."""
DECIMALS = 3


@dataclass(frozen=True)
class Direction:
    """Joints that vary together.

    Attributes:
        name: names of the joints, joined by "+".
        joints: (joint, sign): each moves by sign times the offset.
        span: width of the narrowest joint range (rad or m).
    """

    name: str
    joints: tuple[tuple[str, float], ...]
    span: float


class PostureSpace:
    """Variations of the postures of one hand.

    An offset vector (2 n,) holds the offsets of the n directions in the open posture, then those
    in the closed one, in joint units; zeros are the postures of the description.

    Raises:
        InvalidRequestError: the gripper is no hand, or none of its fingers has a driven joint.
    """

    def __init__(self, gripper: Gripper) -> None:
        if gripper.description.kind != "hand":
            raise InvalidRequestError(
                f"{gripper.name} is of kind '{gripper.description.kind}'; expected a hand. Jaws "
                "have one closing motion, which their data sheet gives."
            )
        self.gripper = gripper
        self.directions = _directions(gripper)
        if not self.directions:
            raise InvalidRequestError(
                f"no finger of {gripper.name} has a driven joint; expected drives on the links "
                "below those that 'fingers' names. See 'actuation' in its gripper.yaml."
            )
        self._spans = np.tile([direction.span for direction in self.directions], 2)

    def __len__(self) -> int:
        return 2 * len(self.directions)

    def draw(
        self, centre: Sequence[float], scale: float, rng: np.random.Generator
    ) -> tuple[float, ...]:
        """An offset vector near `centre`: half of its entries moved by a normal deviate.

        scale: standard deviation as a share of each joint's range.
        """
        step = rng.normal(size=len(self)) * scale * self._spans
        step[rng.random(len(self)) > CHANGED] = 0.0
        # Rounded, so that a vector read back from a file is the same key.
        return tuple(float(v) for v in np.round(np.asarray(centre) + step, DECIMALS))

    def describe(self, offsets: Sequence[float]) -> GripperDescription:
        """The description with its postures moved by `offsets` and kept within the limits."""
        if len(offsets) != len(self):
            raise InvalidRequestError(
                f"{len(offsets)} offsets were given for {self.gripper.name}; expected "
                f"{len(self)}, one per direction and posture."
            )
        half = len(self.directions)
        made = {
            posture: PostureDescription(joints=self._posture(posture, offsets[start:][:half]))
            for posture, start in zip(POSTURES, (0, half), strict=True)
        }
        return replace(self.gripper.description, open=made["open"], closed=made["closed"])

    def _posture(self, name: str, offsets: Sequence[float]) -> dict[str, float]:
        joints = self.gripper.posture(name)
        model = self.gripper.model
        for direction, offset in zip(self.directions, offsets, strict=True):
            for joint, sign in direction.joints:
                value = joints[joint] + sign * offset
                if model.joint(joint).limited[0]:
                    low, high = model.joint(joint).range
                    value = min(max(value, float(low)), float(high))
                joints[joint] = value
        return {joint: round(value, 4) for joint, value in joints.items()}


def _directions(gripper: Gripper) -> list[Direction]:
    """Group the driven finger joints by finger group and place in their finger's chain."""
    model = gripper.model
    poses = gripper.body_poses("open")
    chains = [[model.body(link).id for link in links] for links in gripper.description.fingers]
    found: dict[tuple[int, int], list[tuple[str, float]]] = {}
    for joints in _driven(model):
        body = int(model.jnt_bodyid[joints[0]])
        group = int(gripper.finger_groups[body])
        if group < 0:
            continue
        root = _root(model, body, chains[group])
        # Listed links of one finger lie below each other: only the topmost are fingers.
        roots = [link for link in chains[group] if _root(model, link, chains[group]) == link]
        middle = np.mean([poses[link, 1, 3] for link in roots])
        side = float(poses[root, 1, 3] - middle) if len(roots) > 1 else 0.0
        sign = _sign(gripper, poses, joints[0], side) if len(roots) > 1 else 1.0
        if sign:
            members = found.setdefault((group, _place(model, joints[0], root)), [])
            members += [(model.joint(joint).name, sign) for joint in joints]
    out = []
    for _, members in sorted(found.items()):
        ranges = [model.joint(joint).range for joint, _ in members]
        spans = [float(high - low) for low, high in ranges if high > low]
        name = "+".join(joint for joint, _ in members)
        out.append(Direction(name, tuple(members), min(spans, default=float(np.pi))))
    return out


def _driven(model: mujoco.MjModel) -> list[list[int]]:
    """Joints of every actuator; those of one tendon together, for only their sum is driven."""
    out = []
    for index in range(model.nu):
        target = int(model.actuator_trnid[index, 0])
        if model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON:
            start, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            wraps = range(start, start + count)
            out.append(
                [
                    int(model.wrap_objid[i])
                    for i in wraps
                    if model.wrap_type[i] == mujoco.mjtWrap.mjWRAP_JOINT
                ]
            )
        else:
            out.append([target])
    return [joints for joints in out if joints]


def _root(model: mujoco.MjModel, body: int, links: Sequence[int]) -> int:
    """The topmost of `links` that `body` is or hangs on."""
    root, above = body, body
    while above:
        if above in links:
            root = above
        above = int(model.body_parentid[above])
    return root


def _place(model: mujoco.MjModel, joint: int, root: int) -> int:
    """Number of joints from the finger's root to this one."""
    body = int(model.jnt_bodyid[joint])
    count = joint - int(model.body_jntadr[body])
    while body != root:
        body = int(model.body_parentid[body])
        count += int(model.body_jntnum[body])
    return count


def _sign(gripper: Gripper, poses: NDArray[np.float64], joint: int, side: float) -> float:
    """Sign that makes a joint that moves its finger sideways spread it from the group's middle;
    0 for a finger in the middle, 1 for joints that bend.
    """
    model = gripper.model
    body = int(model.jnt_bodyid[joint])
    tip = max(
        (b for b in range(model.nbody) if _hangs_on(model, b, body)),
        key=lambda b: float(np.linalg.norm(poses[b, :3, 3] - poses[body, :3, 3])),
    )
    # The origin of the last link lies short of the tip; its centre of mass does not.
    arm = poses[tip, :3, :3] @ model.body_ipos[tip] + poses[tip, :3, 3]
    anchor = poses[body, :3, :3] @ model.jnt_pos[joint] + poses[body, :3, 3]
    axis = poses[body, :3, :3] @ model.jnt_axis[joint]
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    motion = axis if slide else np.cross(axis, arm - anchor)
    if abs(motion[1]) < max(abs(motion[0]), abs(motion[2])):
        return 1.0
    return 0.0 if abs(side) < SAME_PLACE else float(np.sign(motion[1] * side))


def _hangs_on(model: mujoco.MjModel, body: int, above: int) -> bool:
    while body and body != above:
        body = int(model.body_parentid[body])
    return body == above

"""Fingers: which branches are fingers, what drives them, where they end, how they curl."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from .drives import HALF_TURN, SLIDE_REACH
from .mechanism import Branch, Mechanism, palm_centre
from .motion import DriveMotion

MOVED = 0.02
"""A joint follows a drive that moves it by more than this share of the joint's own range."""

PARALLEL = 0.95
TIP_SHARE = 0.15
ROOT_SHARE = 0.05
BESIDE = 0.3
"""A part that leads less than this share aside from its direction of motion is a bellows."""

ASIDE = 1e-4
"""Fingers whose root lies nearer (m) to the middle of all have no side of their own."""

LEVER_REACH = 0.9
"""A branch on another's drives and beside it that reaches less than this share is its lever."""

LEVER_APART = 0.08
"""A lever stays this close to its finger, in shares of the finger's reach."""

PAIRED = -0.8
"""Parts whose ways have this cosine or less move against each other."""

ASKEW = 0.2
"""Ways with a cosine below this are across each other."""

STILL = 0.1
"""The middle of a gear goes by less than this share of the way of those it drives."""


@dataclass(frozen=True)
class Finger:
    """One finger.

    `bodies`: its links with the levers beside it. `links`: its own branch. `curl`: drives that
    bend (or slide) it, from the palm outwards. `spread`: drives that turn its plane. `flexing`:
    +1 or -1 for each curl drive: the sign of its length that bends the finger the way its joints
    bend farther. `tip_body`, `tip_point` (3,): middle of its pad, in the frame of its last link.
    `moving`: joints of its chain that a drive moves; `sense`: sign in which the last one flexes.
    """

    name: str
    links: tuple[int, ...]
    bodies: tuple[int, ...]
    tip: tuple[int, ...]
    chain: tuple[int, ...]
    curl: tuple[int, ...]
    spread: tuple[int, ...]
    flexing: tuple[float, ...]
    tip_body: int
    tip_point: NDArray[np.float64]
    sliding: bool
    moving: tuple[int, ...]
    sense: float

    def tip_at(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the middle (3,) of the fingertip, model frame."""
        pose = poses[self.tip_body]
        return pose[:3, :3] @ self.tip_point + pose[:3, 3]


def joint_gains(motion: DriveMotion) -> NDArray[np.float64]:
    """Return how far each joint moves per unit of each drive (drives, njnt), about the middle."""
    adr = motion.model.jnt_qposadr
    base = motion.rest()
    out = np.zeros((len(motion.drives), motion.model.njnt))
    for index in range(len(motion.drives)):
        ends = []
        for length in (motion.low[index], motion.high[index]):
            lengths = base.copy()
            lengths[index] = length
            ends.append(motion.qpos(lengths)[adr])
        span = motion.high[index] - motion.low[index]
        out[index] = (ends[1] - ends[0]) / max(float(span), 1e-9)
    return out


def joint_shares(motion: DriveMotion, gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of its own range by which each joint moves over the range of each drive
    (drives, njnt): a slide on a spindle goes by a few millimetres per radian, and all its way.
    """
    slide = motion.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    assumed = 2.0 * np.where(slide, SLIDE_REACH, HALF_TURN)
    own = np.minimum(motion.ranges[:, 1] - motion.ranges[:, 0], assumed)
    spans = motion.high - motion.low
    return np.abs(gains) * spans[:, None] / np.maximum(own, 1e-9)


def find_fingers(mechanism: Mechanism, motion: DriveMotion) -> tuple[Finger, ...]:
    """Return the fingers, longest first; none where no drive moves a branch.

    Branches that move beside a longer one on the same drives are levers of its linkage and go to
    the finger that they are nearest to. Gears and pistons that drive the fingers are none.
    """
    gains = joint_gains(motion)
    shares = joint_shares(motion, gains)
    driven = [b for b in mechanism.branches if _drives_of(b, shares)]
    ends = [motion.poses(lengths) for lengths in (motion.rest(), motion.low, motion.high)]
    gears = _gears(mechanism, driven, shares, ends[1:])
    driven = [b for b in driven if b not in gears]
    fingers = [b for b in driven if not _is_lever(mechanism, b, driven, shares, ends)]
    if not fingers:
        return ()
    poses = ends[0]
    extra: dict[int, list[int]] = {branch.root: [] for branch in fingers}
    for branch in mechanism.branches:
        if branch in fingers or branch in gears:
            continue
        near = _nearest(mechanism, poses, branch, fingers)
        extra[near.root] += list(branch.bodies)
    return tuple(
        _finger(mechanism, motion, (gains, shares), branch, extra[branch.root], poses)
        for branch in fingers
    )


def joint_axes(
    motion: DriveMotion, lengths: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return joint anchors and unit axes (njnt, 3) in the model frame."""
    data = mujoco.MjData(motion.model)
    data.qpos[:] = motion.qpos(lengths)
    mujoco.mj_kinematics(motion.model, data)
    return data.xanchor.copy(), data.xaxis.copy()


def crossed_over(
    fingers: Sequence[Finger], motion: DriveMotion, lengths: NDArray[np.float64]
) -> bool:
    """Whether the tip of a turning finger lies, in the plane in which it turns, on the far side
    of the middle of all roots, for driven lengths (n,).
    """
    turning = [finger for finger in fingers if not finger.sliding]
    if len(turning) < 2:
        return False
    poses = motion.poses(lengths)
    anchors, axes = joint_axes(motion, lengths)
    first = [finger.moving[0] for finger in turning]
    middle = anchors[first].mean(axis=0)
    for finger, joint in zip(turning, first, strict=True):
        across = np.eye(3) - np.outer(axes[joint], axes[joint])
        root = across @ (anchors[joint] - middle)
        if (
            float(np.linalg.norm(root)) > ASIDE
            and float(root @ (finger.tip_at(poses) - middle)) < 0.0
        ):
            return True
    return False


def leads_aside(
    mechanism: Mechanism,
    poses: NDArray[np.float64],
    finger: Finger,
    axis: NDArray[np.float64],
) -> float:
    """Return the share of a finger's way from its root, the part nearest to the palm, to its tip
    that is not along the unit `axis` (3,) of its motion.
    """
    palm = mechanism.surface(poses, mechanism.palm)
    if not len(palm):
        return 1.0
    points = mechanism.surface(poses, finger.links)
    distance = np.asarray(KDTree(palm).query(points)[0])
    root = points[distance <= np.quantile(distance, ROOT_SHARE)].mean(axis=0)
    ahead = finger.tip_at(poses) - root
    aside = ahead - ahead @ axis * axis
    return float(np.linalg.norm(aside) / max(np.linalg.norm(ahead), 1e-9))


def _drives_of(branch: Branch, shares: NDArray[np.float64]) -> set[int]:
    return set(np.flatnonzero(shares[:, list(branch.chain)].max(axis=1) > MOVED).tolist())


def _gears(
    mechanism: Mechanism,
    driven: Sequence[Branch],
    shares: NDArray[np.float64],
    ends: Sequence[NDArray[np.float64]],
) -> list[Branch]:
    """Return the branches that only drive two others on the same drives, which move against each
    other: those that turn about themselves, as gears, or move across, as pistons.
    """
    before, after = ends
    way = {
        b.root: (mechanism.surface(after, b.bodies) - mechanism.surface(before, b.bodies)).mean(
            axis=0
        )
        for b in driven
    }
    out = []
    for branch in driven:
        own = _drives_of(branch, shares)
        ways = [way[b.root] for b in driven if b is not branch and _drives_of(b, shares) == own]
        pairs = [(a, b) for a, b in itertools.combinations(ways, 2) if _cosine(a, b) <= PAIRED]
        if not pairs:
            continue
        still = np.linalg.norm(way[branch.root]) < STILL * max(np.linalg.norm(w) for w in ways)
        if still or all(abs(_cosine(way[branch.root], w)) < ASKEW for w in ways):
            out.append(branch)
    return out


def _cosine(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)


def _is_lever(
    mechanism: Mechanism,
    branch: Branch,
    others: Sequence[Branch],
    shares: NDArray[np.float64],
    ends: Sequence[NDArray[np.float64]],
) -> bool:
    """Whether a branch moves beside a longer one on the same drives, wherever these stand."""
    own = _drives_of(branch, shares)
    return any(
        branch.reach < LEVER_REACH * other.reach
        and own <= _drives_of(other, shares)
        and max(_apart(mechanism, poses, branch, other) for poses in ends)
        < LEVER_APART * other.reach
        for other in others
        if other is not branch
    )


def _apart(
    mechanism: Mechanism, poses: NDArray[np.float64], branch: Branch, other: Branch
) -> float:
    """Return the distance (m) between two branches."""
    tree = KDTree(mechanism.surface(poses, other.bodies))
    return float(np.min(tree.query(mechanism.surface(poses, branch.bodies))[0]))


def _nearest(
    mechanism: Mechanism,
    poses: NDArray[np.float64],
    branch: Branch,
    fingers: Sequence[Branch],
) -> Branch:
    middle = mechanism.surface(poses, branch.bodies).mean(axis=0)
    distance = [
        np.linalg.norm(mechanism.surface(poses, finger.bodies) - middle, axis=1).min()
        for finger in fingers
    ]
    return fingers[int(np.argmin(distance))]


def _finger(
    mechanism: Mechanism,
    motion: DriveMotion,
    follows: tuple[NDArray[np.float64], NDArray[np.float64]],
    branch: Branch,
    extra: list[int],
    poses: NDArray[np.float64],
) -> Finger:
    """Return a finger; `follows`: gains and shares of the joints (drives, njnt)."""
    model = mechanism.model
    gains, shares = follows
    anchors, axes = joint_axes(motion, motion.rest())
    strength = shares[:, list(branch.chain)]
    moving = [j for j, s in zip(branch.chain, strength.max(axis=0), strict=True) if s > MOVED]
    last = moving[-1]
    alike = [
        j
        for j in moving
        if model.jnt_type[j] == model.jnt_type[last] and abs(axes[j] @ axes[last]) > PARALLEL
    ]
    drives = _drives_of(branch, shares)
    curl = [d for d in drives if shares[d, alike].max() > MOVED]
    curl.sort(key=lambda d: min(j for j in alike if shares[d, j] > MOVED))
    # All parallel joints flex in one sense of rotation: the one in which they have more room.
    room = sum(float(axes[j] @ axes[last]) * float(motion.ranges[j].sum()) for j in alike)
    sense = 1.0 if room >= 0.0 else -1.0
    flexing = tuple(
        float(np.sign(sense * sum(gains[d, j] * (axes[j] @ axes[last]) for j in alike)) or 1.0)
        for d in curl
    )
    # A last joint that only a spring moves has no drive.
    end = branch.chain[-1] if model.jnt_type[branch.chain[-1]] == model.jnt_type[last] else last
    tip_body, tip = _tip(mechanism, poses, branch, anchors[end], last)
    return Finger(
        name=model.body(branch.root).name,
        links=branch.bodies,
        bodies=tuple(sorted({*branch.bodies, *extra})),
        tip=branch.tip,
        chain=branch.chain,
        curl=tuple(curl),
        spread=tuple(sorted(drives - set(curl))),
        flexing=flexing,
        tip_body=tip_body,
        tip_point=tip,
        sliding=bool(model.jnt_type[last] == mujoco.mjtJoint.mjJNT_SLIDE),
        moving=tuple(moving),
        sense=sense,
    )


def _tip(
    mechanism: Mechanism,
    poses: NDArray[np.float64],
    branch: Branch,
    anchor: NDArray[np.float64],
    last: int,
) -> tuple[int, NDArray[np.float64]]:
    """Return the tip's body and the middle (3,) of the last link's end in that body's frame."""
    slide = mechanism.model.jnt_type[last] == mujoco.mjtJoint.mjJNT_SLIDE
    start = palm_centre(mechanism, poses) if slide else anchor
    points = mechanism.surface(poses, branch.tip)
    far = np.linalg.norm(points - start, axis=1)
    end = points[far >= np.quantile(far, 1.0 - TIP_SHARE)].mean(axis=0)
    if not slide:
        # Objects are held by the middle of the last link, not by the nail.
        end = (end + anchor) / 2.0
    pose = poses[branch.tip[0]]
    return branch.tip[0], pose[:3, :3].T @ (end - pose[:3, 3])

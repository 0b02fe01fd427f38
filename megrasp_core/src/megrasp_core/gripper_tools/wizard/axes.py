"""Approach and closing axis of a gripper in its model's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from .fingers import joint_axes
from .mechanism import Mechanism, palm_centre
from .motion import DriveMotion
from .opposition import Opposition

CLOSING_SNAP = np.radians(10.0)
"""A closing axis this close to an axis of the model or its palm is that axis: nearly all models
are drawn that way."""

APPROACH_SNAP = np.radians(20.0)
"""The same for the approach of jaws, whose estimate rests on the middle of the palm."""

EXACT = np.radians(1.0)
"""An axis this close is one of the palm even where the model's are near, too."""

HAND_SNAP = np.radians(10.0)
SQUARE = 0.02
"""Cosine below which an axis of the model counts as perpendicular to the closing axis."""

ROOT_SHARE = 0.05


@dataclass(frozen=True)
class Axes:
    """Unit vectors (3,) in the model frame, perpendicular; `snapped` (2,): angles (rad) by which
    closing and approach were turned onto an axis of the model, NaN where none was near.
    """

    closing: NDArray[np.float64]
    approach: NDArray[np.float64]
    snapped: tuple[float, float]

    def rotation(self) -> NDArray[np.float64]:
        """Return gripper_from_model as a rotation (3, 3)."""
        return np.stack([self.closing, np.cross(self.approach, self.closing), self.approach])


def find_axes(
    mechanism: Mechanism,
    motion: DriveMotion,
    opposition: Opposition,
    hand: bool,
    closing: NDArray[np.float64] | None = None,
    approach: NDArray[np.float64] | None = None,
) -> Axes:
    """Return the axes; those given (any length, model frame) are kept.

    The closing axis is that of the opposition; a hand's is laid into the plane its fingers curl
    in. The approach of jaws leads from where the fingers leave the palm to their tips, that of a
    hand from the middle of the palm to where the fingertips meet.
    """
    poses = motion.poses(opposition.open)
    frames = [np.eye(3), poses[mechanism.palm[-1], :3, :3], poses[mechanism.palm[0], :3, :3]]
    turned = [np.nan, np.nan]
    given = closing
    if approach is not None:
        approach = approach / np.linalg.norm(approach)
    if closing is None:
        closing = _in_curl_plane(motion, opposition) if hand else opposition.axis
        if approach is not None:
            closing = _across(closing, approach)
        closing, turned[0] = _snap(closing, frames, HAND_SNAP if hand else CLOSING_SNAP)
    closing = closing / np.linalg.norm(closing)
    if approach is None:
        ahead = opposition.middle - palm_centre(mechanism, poses)
        if hand:
            normal = _curl_normal(motion, opposition)
            ahead = ahead if normal is None else ahead - ahead @ normal * normal
        else:
            ahead = _outward(mechanism, poses, opposition, ahead)
        approach = _across(ahead, closing)
        limit = HAND_SNAP if hand else APPROACH_SNAP
        approach, turned[1] = _snap(approach, frames, limit, closing)
    closing = _across(closing, approach)
    if given is None and closing[int(np.argmax(np.abs(closing)))] < 0.0:
        # The sign is free; along a model's axis rather than against it.
        closing = -closing
    return Axes(closing, approach, (turned[0], turned[1]))


def _outward(
    mechanism: Mechanism,
    poses: NDArray[np.float64],
    opposition: Opposition,
    otherwise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the mean direction (3,) from the fingers' roots to their tips, both sides alike.

    A root is the part of a finger nearest to the palm: brackets and cables beside it do not count,
    as they would in the palm's middle. Without a palm's shape `otherwise` is returned.
    """
    palm = mechanism.surface(poses, mechanism.palm)
    if not len(palm):
        return otherwise
    tree = KDTree(palm)
    sides = []
    for group in opposition.groups:
        ways = []
        for finger in group:
            points = mechanism.surface(poses, finger.links)
            distance = np.asarray(tree.query(points)[0])
            root = points[distance <= np.quantile(distance, ROOT_SHARE)].mean(axis=0)
            ways.append(finger.tip_at(poses) - root)
        if ways:
            sides.append(np.mean(ways, axis=0))
    return np.mean(sides, axis=0)


def _in_curl_plane(motion: DriveMotion, opposition: Opposition) -> NDArray[np.float64]:
    """Return the closing axis without its part along the curl axes of the larger group."""
    normal = _curl_normal(motion, opposition)
    return opposition.axis if normal is None else _across(opposition.axis, normal)


def _curl_normal(motion: DriveMotion, opposition: Opposition) -> NDArray[np.float64] | None:
    """Return the mean curl axis of the larger group, None where its fingers curl differently."""
    _, axes = joint_axes(motion, opposition.open)
    group = max(opposition.groups, key=len)
    normal = sum((axes[f.moving[-1]] * f.sense for f in group), np.zeros(3))
    size = float(np.linalg.norm(normal))
    return None if size < 0.5 * len(group) else normal / size


def _across(vector: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector of the part of a vector perpendicular to a unit axis."""
    out = vector - vector @ axis * axis
    size = float(np.linalg.norm(out))
    if size < 1e-6:
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        return _across(helper, axis)
    return out / size


def _snap(
    vector: NDArray[np.float64],
    frames: Sequence[NDArray[np.float64]],
    limit: float,
    across: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Return the nearest axis of the first frame that has one within the limit, or of one that has
    it exactly, and the angle to it (rad); else the vector itself and NaN. `across`: a direction it
    must be perpendicular to.
    """
    found = []
    for frame in frames:
        known = np.concatenate([frame.T, -frame.T])
        if across is not None:
            known = known[np.abs(known @ across) < SQUARE]
        if not len(known):
            continue
        nearest = known[int(np.argmax(known @ vector))]
        angle = float(np.arccos(np.clip(nearest @ vector, -1.0, 1.0)))
        found.append((angle, nearest / np.linalg.norm(nearest)))
    for most in (EXACT, limit):
        for angle, nearest in found:
            if angle <= most:
                return nearest, angle
    return vector, float("nan")

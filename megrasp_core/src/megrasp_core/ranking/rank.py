"""Score of a grasp and suppression of near duplicates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from megrasp_core.ranges import LENGTH, POSITIVE, SHARE, WEIGHT, check_ranges

from .calibration import Calibration
from .check import GraspCheck, angular_distance
from .contact import Contacts

__all__ = ["RankSettings", "excluded", "rejection_counts", "score_grasps", "suppress_duplicates"]

ALWAYS_COUNTED = ("collision", "unseen", "workspace", "tilt", "duplicate")


@dataclass(frozen=True)
class RankSettings:
    """How grasps are ordered.

    The weights serve where there is no confidence. They follow what was measured on 12000
    antipodal candidates in simulated bins: of the grasps that passed the check, 54 % without
    clearance were free of collision, 84 % with 2 to 3 mm, 90 to 95 % above; 85 % without unseen
    points, 70 % with 2 to 10 % of them, 21 % above.

    Attributes:
        calibration: from confidence to probability; None: that of the model, or the confidence as
            it is.
        unseen_weight: the score is multiplied by 1 - weight * unseen share.
        tight_weight: a grasp without clearance loses this share of its score.
        full_clearance: from this clearance on nothing is lost (m).
        duplicate_distance: grasps nearer than this (TCP, m) and
        duplicate_angle: than this (rad), modulo the gripper's symmetry, are the same grasp.
    """

    calibration: Calibration | None = None
    unseen_weight: float = 2.0
    tight_weight: float = 0.4
    full_clearance: float = 0.003
    duplicate_distance: float = 0.01
    duplicate_angle: float = float(np.deg2rad(15.0))

    def __post_init__(self) -> None:
        check_ranges(
            self,
            unseen_weight=WEIGHT,
            tight_weight=SHARE,
            full_clearance=POSITIVE,
            duplicate_distance=LENGTH,
            duplicate_angle=LENGTH,
        )


def score_grasps(
    check: GraspCheck,
    contacts: Contacts | None,
    confidence: np.ndarray | None,
    settings: RankSettings | None = None,
) -> np.ndarray:
    """Score (N,) in 0..1: the calibrated confidence, or without one the quality of the contact,
    lowered by what speaks against the grasp.

    Args:
        check: of the same N grasps.
        contacts: what lies between the fingers; None for hands whose fingers do not close along X.
        confidence: (N,) probability of success, or None where the model has no confidence head.
        settings: see `RankSettings`.
    """
    s = settings or RankSettings()
    if confidence is not None:
        return (s.calibration or Calibration()).probability(check, confidence)
    unseen = check.unseen_share.astype(np.float64)
    score = np.clip(1.0 - s.unseen_weight * unseen, 0.0, 1.0)
    score *= 1.0 - s.tight_weight * (1.0 - np.clip(check.clearance / s.full_clearance, 0.0, 1.0))
    return score * (0.5 if contacts is None else contacts.quality)


def suppress_duplicates(
    world_from_tcp: np.ndarray,
    score: np.ndarray,
    symmetry: int = 1,
    settings: RankSettings | None = None,
) -> np.ndarray:
    """Mask (N,) of grasps that repeat a better one.

    Args:
        world_from_tcp: (N, 4, 4).
        score: (N,), higher is better; equal scores keep the first.
        symmetry: n-fold symmetry about +Z through the TCP.
        settings: see `RankSettings`.
    """
    s = settings or RankSettings()
    poses = np.asarray(world_from_tcp, dtype=np.float64)
    order = np.argsort(-score, kind="stable")
    duplicate = np.zeros(len(poses), dtype=bool)
    if len(poses) < 2:
        return duplicate
    close = _same_grasp(poses, poses, symmetry, s.duplicate_distance, s.duplicate_angle)
    for place, index in enumerate(order):
        if not duplicate[index]:
            worse = order[place + 1 :]
            duplicate[worse[close[index, worse]]] = True
    return duplicate


def excluded(
    world_from_tcp: np.ndarray,
    exclude: np.ndarray,
    radius: float,
    symmetry: int = 1,
    angle: float = float(np.deg2rad(30.0)),
) -> np.ndarray:
    """Mask (N,) of grasps that repeat one that failed before.

    Args:
        world_from_tcp: (N, 4, 4).
        exclude: (E, 4, 4) TCP poses that failed.
        radius: largest distance of the TCPs (m).
        symmetry: n-fold symmetry about +Z through the TCP.
        angle: largest angle (rad): from another side the same place may well be grasped.
    """
    if len(exclude) == 0:
        return np.zeros(len(world_from_tcp), dtype=bool)
    same = _same_grasp(np.asarray(world_from_tcp), np.asarray(exclude), symmetry, radius, angle)
    return np.asarray(same.any(axis=1))


def rejection_counts(reason: np.ndarray) -> dict[str, int]:
    """Number of grasps per reason; those of `ALWAYS_COUNTED` are always present, the others
    where they occur.
    """
    counts: dict[str, int] = {name: 0 for name in ALWAYS_COUNTED}
    names, numbers = np.unique(reason[reason != ""], return_counts=True)
    counts.update({str(name): int(number) for name, number in zip(names, numbers)})
    return counts


def _same_grasp(
    a: np.ndarray, b: np.ndarray, symmetry: int, distance: float, angle: float
) -> np.ndarray:
    """Matrix (A, B): whether two TCP poses are within the distance and, modulo the symmetry, the
    angle.
    """
    near = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=2) < distance
    turned = np.zeros_like(near)
    for k in range(max(symmetry, 1)):
        c, s = np.cos(2 * np.pi * k / max(symmetry, 1)), np.sin(2 * np.pi * k / max(symmetry, 1))
        about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        turned |= angular_distance(a[:, None, :3, :3], (b[:, :3, :3] @ about_z)[None]) < angle
    return near & turned

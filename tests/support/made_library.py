"""A library whose counts are plain to see."""

from __future__ import annotations

import numpy as np

from megrasp_core.library import GraspLibrary
from megrasp_core.storage import GraspSet

FAR = 0.01
"""Distance of every TCP from its object's centre (m)."""


def made_set(
    gripper: str, name: str, held: int, reasons: tuple[str, ...], drawn: int, tried: int
) -> GraspSet:
    """`held` successes of quality 0.2, 0.4, 0.2, ..., then a failure for each of `reasons`."""
    count = held + len(reasons)
    pose = np.zeros((count, 7))
    pose[:, 2], pose[:, 6] = -FAR, 1.0
    success = np.arange(count) < held
    quality = np.where(success, np.where(np.arange(count) % 2, 0.4, 0.2), 0.0)
    reason = np.array([""] * held + list(reasons), np.str_)
    digest = f"hash of {gripper}"
    return GraspSet(
        gripper, digest, name, pose, success, quality.astype(np.float32), reason, drawn, tried
    )


def made_library(jaw: str = "franka_hand", other: str = "robotiq_2f85") -> GraspLibrary:
    """Two grippers, three objects: one is a scan, one is labelled for `jaw` alone."""
    return GraspLibrary(
        [
            made_set(jaw, "procedural/000000", 4, ("slipped", "slipped"), 30, 10),
            made_set(jaw, "procedural/000003", 0, ("no_contact",), 12, 5),
            made_set(jaw, "asset/train/nowhere/cup", 100, ("slipped",) * 100, 400, 210),
            made_set(other, "procedural/000000", 2, (), 8, 2),
            made_set(other, "asset/train/nowhere/cup", 0, (), 5, 0),
        ]
    )

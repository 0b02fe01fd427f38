"""Axis-aligned bounds of boxes that are fixed to a gripper."""

from __future__ import annotations

import numpy as np

__all__ = ["inside_bounds", "posed_box_bounds"]


def posed_box_bounds(
    pose: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner (3,), float32, in the outer frame, of what encloses a posed box.

    Args:
        pose: (4, 4) outer_from_box.
        low: (3,) corner of the box in its own frame (m).
        high: (3,) the opposite corner.
    """
    half = 0.5 * (high - low)
    middle = pose[:3, :3] @ (low + half) + pose[:3, 3]
    reach = np.abs(pose[:3, :3]) @ half
    return (middle - reach).astype(np.float32), (middle + reach).astype(np.float32)


def inside_bounds(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which points (3, P) lie between two corners (3,): (P,) bool."""
    x, y, z = points
    near = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    return near & (z >= low[2]) & (z <= high[2])

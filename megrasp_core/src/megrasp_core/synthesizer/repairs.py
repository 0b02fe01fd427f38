"""Grasps near those that fail for a reason that has a remedy: turned over, or further back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from megrasp_core.ranking import SweepSettings

from .polish import promises
from .rows import with_rows
from .scene_judge import Assessment

__all__ = ["backed_off", "turned_over"]

STEEP = np.deg2rad(60.0)
"""Grasps that come from further to the side than this, or from below, are turned over."""
HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
"""About the closing axis: the same contacts, approached from the other side."""


def turned_over(
    drawn: Assessment, assess: Callable[[np.ndarray], Assessment]
) -> tuple[Assessment, np.ndarray]:
    """Replace grasps from below, or in collision from the side, by the same contacts from the
    other side where that promises more.

    Args:
        drawn: N poses of a gripper whose fingers close along X.
        assess: assessment of TCP poses (n, 4, 4).

    Returns:
        N poses, and the rows that were replaced.
    """
    tilt = np.nan_to_num(drawn.check.tilt, nan=np.pi)
    rows = np.flatnonzero(~drawn.check.passed & (tilt > STEEP))
    if not len(rows):
        return drawn, rows
    turned = assess(drawn.poses.tcp[rows] @ HALF_TURN)
    better = np.flatnonzero(promises(turned) > promises(drawn)[rows])
    return with_rows(drawn, rows[better], turned, better), rows[better]


def backed_off(
    found: Assessment, assess: Callable[[np.ndarray], Assessment], settings: SweepSettings
) -> Assessment:
    """Move grasps whose fingers hit something while they close back along their approach, by the
    least step after which they pass with the material still well between the fingers.

    Args:
        found: N poses.
        assess: assessment of TCP poses (n, 4, 4) with everything.
        settings: the steps, and the least engagement.
    """
    rows = np.flatnonzero(found.check.reason == "sweep")
    if not len(rows):
        return found
    back = np.tile(np.eye(4), (len(settings.back_off), 1, 1))
    back[:, 2, 3] = -np.asarray(settings.back_off)
    tried = assess((found.poses.tcp[rows, None] @ back).reshape(-1, 4, 4))
    assert tried.contacts is not None
    passed = tried.check.passed & (tried.contacts.engagement >= settings.least_engagement)
    passed = passed.reshape(len(rows), -1)
    saved = np.flatnonzero(passed.any(axis=1))
    first = saved * len(back) + passed[saved].argmax(axis=1)
    return with_rows(found, rows[saved], tried, first)

"""What came of robust labels: how many trials grasps held, why they did not, and what it took."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from megrasp_core.grippers import is_procedural

from .records import NOT_TRIED, ROBUST_TRIALS, GripperLabels, Kind

Held = dict[str, list[int]]
"""By kind and plain label, such as "judged_success": grasps that held in 0, 1, ... trials."""


def counted_as(gripper: str) -> str:
    """The name under which a gripper is counted: all procedural ones as one."""
    return "procedural" if is_procedural(gripper) else gripper


def held_counts(labels: GripperLabels) -> Held:
    """The counts of one gripper in one scene; empty where nothing was tried again."""
    found: Held = {}
    tried = labels.robust != NOT_TRIED
    for kind in Kind:
        for label, outcome in ((1, "success"), (0, "failure")):
            rows = tried & (labels.kind == kind) & (labels.label == label)
            if rows.any():
                counts = np.bincount(labels.robust[rows], minlength=ROBUST_TRIALS + 1)
                found[f"{kind.name.lower()}_{outcome}"] = counts.tolist()
    return found


def joined_counts(parts: Iterable[Held]) -> Held:
    """The sum of several, sorted by name."""
    total: dict[str, np.ndarray] = {}
    for part in parts:
        for name, counts in part.items():
            total[name] = total.get(name, np.zeros(ROBUST_TRIALS + 1, int)) + np.array(counts)
    return {name: counts.tolist() for name, counts in sorted(total.items())}


def robust_stats(held: Mapping[str, Held], runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """What is known of the robust labels of a data set.

    Args:
        held: gripper -> its counts.
        runs: those that made the labels, as `runs_of` tells them.

    Returns:
        `all` and every gripper that has any: `grasps`; `held`, see `Held`; `success_held`, the
        share of the trials in which grasps held that had held in the plain one; and where the runs
        tell it, `trials`, `cpu_seconds_a_grasp` and `failed`, why how many trials under other
        conditions did. Empty without robust labels.
    """
    took: dict[str, Counter[str]] = {}
    failed: dict[str, Counter[str]] = {}
    for run in runs:
        for name, part in run.get("robust", {}).items():
            for key in (counted_as(name), "all"):
                amounts = {what: part[what] for what in ("grasps", "trials", "cpu_seconds")}
                took.setdefault(key, Counter()).update(amounts)
                failed.setdefault(key, Counter()).update(part["failed"])
    counts = {name: part for name, part in sorted(held.items()) if part}
    if not counts:
        return {}
    counts = {"all": joined_counts(counts.values()), **counts}
    return {
        name: _summary(part, took.get(name), failed.get(name)) for name, part in counts.items()
    }


def _summary(held: Held, took: Counter[str] | None, failed: Counter[str] | None) -> dict[str, Any]:
    plain = [np.array(part) for name, part in held.items() if name.endswith("_success")]
    of_successes = sum(plain, np.zeros(ROBUST_TRIALS + 1, int))
    tried = ROBUST_TRIALS * int(of_successes.sum())
    content: dict[str, Any] = {
        "grasps": sum(sum(part) for part in held.values()),
        "held": held,
        "success_held": float(of_successes @ np.arange(ROBUST_TRIALS + 1)) / tried
        if tried
        else None,
    }
    if took and took["grasps"]:
        content["trials"] = took["trials"]
        content["cpu_seconds_a_grasp"] = took["cpu_seconds"] / took["grasps"]
        content["failed"] = dict((failed or Counter()).most_common())
    return content

"""Core-hours of a large data set, from the rates that `megrasp bench --stage data` measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def plan_data(
    rates: Mapping[str, Any],
    scene_seconds: float,
    *,
    objects: int = 1000,
    grippers: int = 13,
    successes: int = 5000,
    scenes: int = 25_000,
    cores: Sequence[int] = (16, 256, 1500),
) -> dict[str, Any]:
    """Core-hours of a grasp library and of scenes, and hours on so many cores.

    A success costs as many full trials as it takes to hold once, at least two, since as many
    failures are wanted, and the collision tests of the grasps drawn for them. Every pair counts as
    feasible, so this is an upper bound; units share nothing, so cores divide.

    Args:
        rates: content of the result file of `megrasp bench --stage data`.
        scene_seconds: CPU-seconds of one core that a scene took.
        objects: of the library.
        grippers: of the library, each as dear as the mean of the measured ones.
        successes: of each pair.
        scenes: of the scene data set.
        cores: numbers of cores to divide by.

    Returns:
        seconds a success by gripper, core-hours of library and scenes, hours by cores.
    """
    by_gripper = {row["gripper"]: _success_seconds(row) for row in rates["rows"]}
    mean = float(np.mean(list(by_gripper.values())))
    library = objects * grippers * successes * mean / 3600.0
    heaps = scenes * scene_seconds / 3600.0
    return {
        "objects": objects,
        "grippers": grippers,
        "successes": successes,
        "scenes": scenes,
        "seconds_a_success": by_gripper,
        "mean_seconds_a_success": mean,
        "scene_seconds": scene_seconds,
        "library_core_hours": library,
        "scene_core_hours": heaps,
        "hours": [
            {"cores": count, "library": library / count, "scenes": heaps / count}
            for count in cores
        ],
        "hardware": rates["hardware"],
    }


def _success_seconds(row: Mapping[str, Any]) -> float:
    held = max(row["yield"] * row["drawn"], 1e-9)
    trials = max(row["full_trials"] / held, 2.0)
    drawn = trials * row["drawn"] / max(row["full_trials"], 1)
    return trials / row["full_trials_per_second"] + drawn / row["collision_tests_per_second"]


def plan_table(plan: Mapping[str, Any]) -> str:
    """The hours of a plan as a markdown table."""
    lines = [
        f"| cores | library: {plan['objects']} objects x {plan['grippers']} grippers x "
        f"{plan['successes']} successes | {plan['scenes']} scenes |",
        "|---|---|---|",
        f"| core-hours | {plan['library_core_hours']:,.0f} | {plan['scene_core_hours']:,.0f} |",
    ]
    for row in plan["hours"]:
        lines.append(f"| {row['cores']} | {_time(row['library'])} | {_time(row['scenes'])} |")
    return "\n".join(lines)


def _time(hours: float) -> str:
    if hours >= 48:
        return f"{hours / 24:.0f} days"
    return f"{hours:.0f} h" if hours >= 2 else f"{60 * hours:.0f} min"

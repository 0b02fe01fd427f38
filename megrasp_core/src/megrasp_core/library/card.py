"""The card of a grasp library: what lies in it, how it was made, whose objects it refers to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from .facts import COMPLETE, OWN_TERMS

__all__ = ["STATS", "library_card"]

STATS = "stats.json"
"""Where the figures of a card lie, beside it."""

PROCEDURAL = "procedural"
COLUMNS = {
    "objects": "objects",
    "objects_with_success": "held",
    "objects_complete": f"{COMPLETE} + {COMPLETE}",
    "successes": "successes",
    "failures_kept": "failures",
    "drawn": "drawn",
    "yield": "yield",
    "held_of_trials": "of full trials",
    "mean_quality": "mean quality",
    "failure_to_success": "failure to success",
    "success_to_success": "to the next",
    "hashes": "description",
}
LEGEND = f"""
Held: objects with any success. {COMPLETE} + {COMPLETE}: objects with so many successes and
failures or more. Yield: successes of all grasps drawn, start collisions included. Failure to
success: median distance of a failure's TCP from that of the nearest success of its pair; to the
next: of a success's. Description: start of the hash of the `gripper.yaml` that the labels belong
to. All figures of this page are in `{STATS}`; `megrasp data stats --out LIBRARY --card FILE`
writes both.
"""
REFERENCE = """
Scans are by reference, set and name (`asset/<split>/<set>/<name>`): meshes are not included and
keep their own terms. `procedural/<number>` is made again from its number.
"""
METHOD = """
Candidates on the object's surface go through the free-space trial: close with the description's
force limits, shake along and about all axes. Then copies of what held, moved a little, do, until
the pair has enough successes and failures, or is given up.
"""
FIELDS = """
## Fields

One packed file a gripper, `<gripper>.npz`; `megrasp_core.library.load_library` reads the folder.

- Per grasp: `object_from_tcp` (x, y, z, qx, qy, qz, qw; metres; +Z approach, +X closing, origin
  between the fingertips), the pose of the open gripper from which closing makes the grasp;
  success; quality from 0, lost, to 1, did not move in the hand while shaken; the reason of a
  failure.
- Per pair: name of the gripper, hash of its description, name of the object, grasps drawn, full
  trials among them.

## Limits

- Free-space labels only: the object floats, gravity is off, nothing else is near. Whether a grasp
  can be reached, and whether it lifts the object out of a heap, is not in them.
- Rigid bodies with one friction (0.8 sliding, 0.01 torsional).
- Failures are full trials that lost the object, as many as were kept; grasps that collide at the
  start are counted, not kept.
- The yield tells how hard a pair was to label, not how good a gripper is: moved copies of what
  held count in it, and work on a pair stops at a number of successes and failures.
- Positions are rounded to 0.01 mm, the quaternion's parts to 1/32767, the quality to 1/255.
"""


def library_card(stats: Mapping[str, Any], command: str | None = None) -> str:
    """Markdown text of the card.

    Args:
        stats: `library_stats`, with the facts of the objects for their sizes and terms.
        command: that made the library; without it one that labels the same pairs is given.
    """
    return "".join(
        [
            "# Grasp library\n\n",
            _what(stats),
            "\n## Grippers\n\n",
            _gripper_table(stats),
            LEGEND,
            "\n## Objects\n\n",
            _object_table(stats),
            REFERENCE,
            _sizes(stats["sizes"]),
            "\n## How it was made\n",
            METHOD,
            _made(stats, command),
            FIELDS,
        ]
    )


def _what(stats: Mapping[str, Any]) -> str:
    count = {key: _whole(value) for key, value in stats.items() if isinstance(value, int)}
    return (
        f"Grasps of single objects, tried in simulation on the object floating in free space:\n"
        f"{count['successes']} that hold and {count['failures_kept']} that do not, "
        f"of {len(stats['grippers'])} grippers on {count['objects']} objects.\n"
        f"Of {count['pairs']} pairs of gripper and object, {count['pairs_with_success']} have a "
        f"success and {count['pairs_complete']} have\n"
        f"{COMPLETE} successes and {COMPLETE} failures or more. "
        f"{count['objects_of_all_grippers']} objects are labelled for every gripper.\n"
    )


def _gripper_table(stats: Mapping[str, Any]) -> str:
    rows = [["gripper", *COLUMNS.values()], ["---"] * (1 + len(COLUMNS))]
    rows += [
        [name, *(_cell(key, entry[key]) for key in COLUMNS)]
        for name, entry in stats["grippers"].items()
    ]
    return _table(rows)


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "-"
    if key == "hashes":
        return ", ".join(f"`{digest[:12]}`" for digest in value)
    if key.endswith("_to_success"):
        return f"{1e3 * value:.0f} mm"
    if key == "mean_quality":
        return f"{value:.2f}"
    return f"{value:.0%}" if isinstance(value, float) else _whole(value)


def _object_table(stats: Mapping[str, Any]) -> str:
    rows = [["source", "objects", "terms of the meshes"], ["---"] * 3]
    for source, count in stats["sources"].items():
        unknown = OWN_TERMS if source == PROCEDURAL else "see `meta.json` in the asset folder"
        terms = "; ".join(stats["terms"].get(source, [unknown]))
        rows.append([source, _whole(count), terms])
    return _table(rows)


def _sizes(sizes: Mapping[str, Any]) -> str:
    if not sizes["objects"]:
        return ""
    return (
        f"\nLeast, median and most of the {_whole(sizes['objects'])} objects that could be "
        f"loaded: smallest edge of the\nbox around it {_range(sizes['smallest_extent'])} mm, "
        f"largest edge {_range(sizes['largest_extent'])} mm,\n"
        f"mass {_range(sizes['mass'])} g.\n"
    )


def _made(stats: Mapping[str, Any], command: str | None) -> str:
    told = "The command" if command else "A command that labels these pairs, seed and effort aside"
    return (
        f"\n{_whole(stats['drawn'])} grasps were drawn: {_whole(stats['start_collisions'])} "
        f"collided at the start, {_whole(stats['trials'])} went through the full trial.\n\n"
        f"{told}, and how it was packed:\n\n```\n{command or _command(stats)}\n"
        "megrasp data pack --out LIBRARY --into models/grasp_library\n```\n\n"
        f"{_runs(stats.get('runs', []))}"
    )


def _runs(runs: list[Mapping[str, Any]]) -> str:
    if not runs:
        return (
            f"Versions when this card was written: megrasp_core {version('megrasp-core')}, "
            f"MuJoCo {version('mujoco')}.\n"
        )
    seeds = sorted({str(run["seed"]) for run in runs if "seed" in run})
    used = {f"{name} {number}" for run in runs for name, number in run["versions"].items()}
    timed = [run for run in runs if run["cpu_seconds"] is not None]
    hours = sum(run["cpu_seconds"] for run in timed) / 3600.0
    cpus = ", ".join(sorted({run["cpu"] for run in timed}))
    spent = f", {_whole(_done(timed))} of them in {hours:.1f} CPU-hours ({cpus})" if timed else ""
    return (
        f"The runs that were logged labelled {_whole(_done(runs))} pairs, some of them again with "
        f"more effort{spent}.\nSeed {', '.join(seeds)}, {', '.join(sorted(used))}. Each run, with "
        "its settings, is a line of `runs.jsonl`.\n"
    )


def _done(runs: list[Mapping[str, Any]]) -> int:
    return sum(run["done"] for run in runs)


def _command(stats: Mapping[str, Any]) -> str:
    numbers = [
        int(found[1])
        for name in stats["grippers_able"]
        if (found := re.fullmatch(rf"{PROCEDURAL}/(\d+)", name))
    ]
    parts = ["megrasp data grasps --out LIBRARY", f"--gripper {' '.join(stats['grippers'])}"]
    parts.append(f"--procedural {max(numbers, default=-1) + 1}")
    if not set(stats["sources"]) - {PROCEDURAL}:
        parts.append("--no-assets")
    return " ".join(parts)


def _table(rows: list[list[str]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _range(values: Mapping[str, float]) -> str:
    return ", ".join(f"{1000 * values[key]:.0f}" for key in ("min", "median", "max"))


def _whole(count: int) -> str:
    return f"{count:,}".replace(",", " ")

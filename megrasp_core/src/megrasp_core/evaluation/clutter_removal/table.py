"""The rates of packed and pile beside the published ones, as a markdown table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

PUBLISHED = (
    ("random edge grasps", "Edge-Grasp's simulator and objects", "40-44", "", "40-44", ""),
    ("VGN", "GIGA's simulator (PyBullet) and objects", "74.5", "79.2", "60.7", "44.0"),
    ("GIGA", "the same", "83.5", "84.3", "69.3", "49.8"),
    ("GIGA, HR", "the same", "87.9", "86.0", "69.8", "51.1"),
    ("EdgeGraspNet", "Edge-Grasp's simulator (PyBullet) and objects", "92.0", "", "89.9", "92.8"),
    ("VN-EdgeGraspNet", "the same", "92.3", "", "92.3", ""),
)
"""planner, simulator and objects, GSR and DR of packed, GSR and DR of pile (%), from the papers of
GIGA and Edge-Grasp."""

ENGINES = {"pybullet": "this page's rounds in PyBullet", "mujoco": "this page's rounds in MuJoCo"}
CAUSES = ("collision", "no_contact", "object_moved", "slipped", "unstable")


def clutter_tables(results: Sequence[Mapping[str, Any]]) -> str:
    """Rates of result files and of others; what the failures were.

    Args:
        results: contents of result files of packed and pile.
    """
    groups: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for content in results:
        settings = content["config"]
        key = (
            content["model"],
            content["gripper"],
            content["engine"],
            settings["object_set"],
            settings["noise"],
        )
        groups.setdefault(key, {})[content["protocol"]] = content
    heads = [
        "planner", "simulator and objects", "packed GSR %", "packed DR %", "pile GSR %",
        "pile DR %",
    ]  # fmt: skip
    own = [
        [f"{model}, {gripper}", f"{ENGINES[engine]}, {objects}, noise {noise}"]
        + [
            _rate(found[scene][rate]) if scene in found else ""
            for scene in ("packed", "pile")
            for rate in ("gsr", "dr")
        ]
        for (model, gripper, engine, objects, noise), found in groups.items()
    ]
    failures = (
        [
            content["protocol"],
            f"{content['engine']}, {content['config']['object_set']}",
            str(content["rounds"]),
            *(str(content["failures"][cause]) for cause in CAUSES),
            str(content["lost"]),
            *(str(content["endings"].get(end, 0)) for end in ("cleared", "failures", "no_grasp")),
        ]
        for content in results
    )
    causes = ["", "", "rounds", *(cause.replace("_", " ") for cause in CAUSES), "objects lost"]
    return "\n".join(
        [
            *_table(heads, [*(list(row) for row in PUBLISHED), *own]),
            "",
            "Failures by cause, objects pushed out of the workspace, endings of the rounds:",
            "",
            *_table([*causes, "cleared", "two failures", "no grasp"], failures),
            "",
        ]
    )


def _rate(entry: Mapping[str, Any]) -> str:
    if entry["ci95"] is None:
        return ""
    text = f"{entry['successes']}/{entry['trials']} = {100 * entry['rate']:.1f}"
    low, high = entry["ci95"]
    # A bootstrap of rounds that all ended alike says nothing of others.
    return text if low == high else f"{text} [{100 * low:.1f}, {100 * high:.1f}]"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(heads)} |",
        "|---" * len(heads) + "|",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]

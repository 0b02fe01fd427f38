"""The tables of floors and stages in docs/evaluation.md:
`python -m megrasp_core.cli.geometry_page docs/evaluation.md docs/results/geometry`.

Rows come from the result files of `megrasp eval` in the folder, named GRIPPER-WHAT.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from .common import block_writer

MARK = "geometry"
WHAT = {
    "table": "table in the cloud",
    "known": "table cut away, its height given",
    "cropped": "table cut away, floor estimated",
    "plain": "none of the three",
    "no_openings": "without openings",
    "no_sweep": "without the closing sweep",
    "no_turns": "without half turns",
    "all": "all of them",
}
CAUSES = ("no_contact", "slipped", "obstacle", "start_collision", "no_answer")


def tables(folder: Path) -> str:
    """One table a protocol."""
    text: list[str] = []
    for protocol, first in (("declutter", "floor"), ("binpick", "stages")):
        heads = [
            "gripper", first, "scenes", "first", *(name.replace("_", " ") for name in CAUSES),
            *(("cleared", "cleared of all") if protocol == "binpick" else ()),
        ]  # fmt: skip
        text += [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
        for gripper, what, content in _results(folder, protocol):
            text.append(f"| {' | '.join(_cells(gripper, what, content))} |")
        text.append("")
    return "\n".join(text)


def _results(folder: Path, protocol: str) -> list[tuple[str, str, dict[str, Any]]]:
    found = []
    for file in folder.glob("*.json"):
        gripper, _, what = file.stem.partition("-")
        content = json.loads(file.read_text())
        if content["protocol"] == protocol:
            found.append((gripper, what, content))
    return sorted(found, key=lambda one: (one[0], list(WHAT).index(one[1])))


def _cells(gripper: str, what: str, content: dict[str, Any]) -> list[str]:
    first = content["first"]
    low, high = (100 * limit for limit in first["ci95"])
    rate = f"{first['successes']}/{first['trials']} = {100 * first['rate']:.1f} %"
    cells = [gripper, WHAT[what], str(content["scenes"]), f"{rate} [{low:.1f}, {high:.1f}]"]
    cells += [str(content["reasons"].get(cause, 0)) for cause in CAUSES]
    if content["protocol"] == "binpick":
        cells += [f"{100 * content[key]:.0f} %" for key in ("cleared", "cleared_of_all")]
    return cells


if __name__ == "__main__":
    page, results = Path(sys.argv[1]), Path(sys.argv[2])
    block_writer(page, MARK)(tables(results))

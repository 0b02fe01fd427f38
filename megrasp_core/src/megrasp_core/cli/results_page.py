"""The rates in docs/results.md: `python -m megrasp_core.cli.results_page docs/results.md`.

Rows come from every result file of `megrasp eval` in the `evaluation` folders of the models and in
docs/results.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .common import block_writer

MARK = "results"
HEADS = ("gripper", "model", "friction", "scenes", "first", "first_all", "filtered", "kept",
         "unfiltered", "cleared", "cleared_of_all", "drawn, returned, evaluations")  # fmt: skip
PLACES = ("models/*/evaluation/*.json", "docs/results/*.json")


def tables(page: Path) -> str:
    """One table a protocol, for a page in docs/ of a checkout."""
    found: dict[str, list[str]] = {}
    for file, content in _results(page.resolve().parents[1]):
        link = os.path.relpath(file, page.resolve().parent)
        found.setdefault(content["protocol"], []).append(_row(content, link))
    text = []
    for protocol, rows in found.items():
        heads = [f"| {' | '.join(HEADS)} |", "| --- " * len(HEADS) + "|"]
        text += [f"### {protocol}", "", *heads, *rows, ""]
    return "\n".join(text)


def _results(root: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    for place in PLACES:
        for file in sorted(root.glob(place)):
            content = json.loads(file.read_text())
            if isinstance(content, dict) and "protocol" in content and "first" in content:
                yield file, content


def _row(content: Mapping[str, Any], link: str) -> str:
    if content["protocol"] == "binpick" and "first_all" not in content:
        # Before impossible attempts were told apart, all of them counted.
        old = {"first_all": content["first"], "cleared_of_all": content["cleared"]}
        content = {**content, **old, "first": None, "cleared": None}
    other = content.get("executed_with", content["gripper"])
    with_other = "" if other == content["gripper"] else f", executed with {other}"
    cells = [
        f"[{content['gripper']}]({link}){with_other}",
        content["model"],
        f"{content['config']['friction']:g}",
        str(content["scenes"]),
        _rate(content["first"]),
        _rate(content.get("first_all")),
        _rate(content.get("filtered")),
        _share(content.get("kept_share")),
        _rate(content.get("unfiltered")),
        _share(content.get("cleared")),
        _share(content.get("cleared_of_all")),
        ", ".join(str(content[key]) for key in ("drawn", "returned", "evaluations")),
    ]
    return f"| {' | '.join(cells)} |"


def _rate(content: Mapping[str, Any] | None) -> str:
    if content is None or not content["trials"]:
        return "-"
    low, high = (100 * limit for limit in content["ci95"])
    return (
        f"{content['successes']}/{content['trials']} = {100 * content['rate']:.1f} % "
        f"[{low:.1f}, {high:.1f}]"
    )


def _share(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"


if __name__ == "__main__":
    goal = Path(sys.argv[1])
    block_writer(goal, MARK)(tables(goal))

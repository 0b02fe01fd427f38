"""The rates and causes in docs/results.md, and pictures of how far scores are to be trusted:
`python -m megrasp_core.cli.results_page docs/results.md`.

Rows come from every result file of `megrasp eval` in the `evaluation` folders of the models, in
docs/results and in that of the first model, which does not ship any more; `reliability.png` is
drawn beside every calibration.json of a model.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from megrasp_core.drawing.reliability_picture import save_reliability_picture
from megrasp_core.evaluation.statistics import wilson

from .common import block_writer

MARK = "results"
CAUSES_MARK = "causes"
HEADS = ("gripper", "model", "friction", "scenes", "first", "first_all", "filtered", "kept",
         "unfiltered", "cleared", "cleared_of_all", "drawn, returned, evaluations")  # fmt: skip
CAUSES = ("slipped", "no_contact", "not_lifted", "start_collision", "approach_collision",
          "obstacle", "bin", "no_answer")  # fmt: skip
CALIBRATIONS = "models/*/evaluation/calibration.json"
PLACES = (
    "models/*/evaluation/*.json",
    "docs/results/*.json",
    "docs/results/megrasp_small/*.json",
)


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


def causes(page: Path) -> str:
    """One table of what became of the best ranked grasps, for a page in docs/ of a checkout."""
    heads = ("gripper", "model", "protocol", "trials", *(c.replace("_", " ") for c in CAUSES))
    lines = [f"| {' | '.join(heads)} |", "| --- " * len(heads) + "|"]
    for file, content in _results(page.resolve().parents[1]):
        reasons = dict(content["reasons"])
        trials, held = sum(reasons.values()), reasons.pop("success", 0)
        if set(reasons) - set(CAUSES):
            raise KeyError(f"{file} has {sorted(reasons)}; expected causes among {CAUSES}")
        cells = [
            f"[{content['gripper']}]({os.path.relpath(file, page.resolve().parent)})",
            content["model"],
            content["protocol"],
            f"{held}/{trials}",
            *(str(reasons.get(cause, "")) for cause in CAUSES),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw_reliability(root: Path) -> None:
    """Draw `reliability.png` beside the reports of `megrasp calibrate` in a checkout."""
    for file in sorted(root.glob(CALIBRATIONS)):
        report = json.loads(file.read_text())
        for part in (report, *report.get("kinds", {}).values()):
            for row in part["reliability"]:
                held = round(row["observed"] * row["count"])
                row["ci95"] = wilson(held, row["count"]).ci95
        save_reliability_picture(report, file.with_name("reliability.png"))


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
    block_writer(goal, CAUSES_MARK)(causes(goal))
    draw_reliability(goal.resolve().parents[1])

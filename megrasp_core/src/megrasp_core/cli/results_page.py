"""The rates and causes in docs/results.md, and pictures of how far scores are to be trusted:
`python -m megrasp_core.cli.results_page docs/results.md`.

Rows come from every result file of `megrasp eval` in the `evaluation` folders of the models, in
docs/results and in that of the first model, which does not ship any more; those in
docs/results/procedural, of grippers of the procedural family, are pooled. `reliability.png` is
drawn beside every calibration.json of a model.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from megrasp_core.drawing.reliability_picture import save_reliability_picture
from megrasp_core.evaluation.statistics import Rate, cluster_bootstrap, wilson

from .common import block_writer

HEADS = ("gripper", "model", "friction", "scenes", "first", "first_all", "filtered", "kept",
         "unfiltered", "cleared", "cleared_of_all", "drawn, returned, evaluations")  # fmt: skip
CAUSES = ("slipped", "no_contact", "not_lifted", "start_collision", "approach_collision",
          "obstacle", "bin", "no_answer")  # fmt: skip
JUDGED_HEADS = ("gripper", "executed with", "model", "scenes", "first", "first of a stage",
                "mean of the returned", "any of a stage", "objects lifted by one stage",
                "AUC of the score")  # fmt: skip
PROCEDURAL_RATES = ("first", "first_all")
PROCEDURAL = "docs/results/procedural/*.json"
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
        text += [f"### {protocol}", "", *_head(HEADS), *rows, ""]
    return "\n".join(text)


def causes(page: Path) -> str:
    """One table of what became of the best ranked grasps, for a page in docs/ of a checkout."""
    causes = (cause.replace("_", " ") for cause in CAUSES)
    lines = _head(("gripper", "model", "protocol", "trials", *causes))
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


def judged(page: Path) -> str:
    """The table of files whose returned grasps were judged (`megrasp eval --judged`)."""
    lines = _head(JUDGED_HEADS)
    for file, content in _results(page.resolve().parents[1]):
        if "judged" in content:
            stages = content["judged_stages"]
            other = content["executed_with"]
            cells = [
                f"[{content['gripper']}]({os.path.relpath(file, page.resolve().parent)})",
                "itself" if other == content["gripper"] else other,
                content["model"],
                str(content["scenes"]),
                _rate(content["first"]),
                _rate(stages["first"]),
                _rate(content["judged"]),
                _rate(stages["any"]),
                f"{stages['objects_lifted']:g}",
                f"{content['score_auc']:.2f}",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def procedural(page: Path) -> str:
    """The table of grippers of the procedural family, by kind; intervals draw grippers again."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for file in sorted(page.resolve().parents[1].glob(PROCEDURAL)):
        content = json.loads(file.read_text())
        kinds.setdefault(content["gripper"].rpartition("_")[0], []).append(content)
    lines = _head(("kind", "grippers", "scenes", *PROCEDURAL_RATES, "first, by gripper"))
    everything = [content for found in kinds.values() for content in found]
    for kind, found in [*sorted(kinds.items()), ("**all**", everything)]:
        rates = [c["first"]["rate"] for c in found if c["first"]["trials"]]
        cells = [
            kind.replace("_", " "),
            str(len(found)),
            str(sum(content["scenes"] for content in found)),
            *(_rate(_pooled(found, key)) for key in PROCEDURAL_RATES),
            f"{100 * min(rates):.0f} to {100 * max(rates):.0f} %" if rates else "-",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _pooled(found: Sequence[Mapping[str, Any]], key: str) -> Mapping[str, Any] | None:
    parts = [content[key] for content in found if key in content]
    if not parts:
        return None
    rate: Rate = cluster_bootstrap(
        [part["successes"] for part in parts], [part["trials"] for part in parts]
    )
    return rate.to_json()


def _head(names: Sequence[str]) -> list[str]:
    return [f"| {' | '.join(names)} |", "| --- " * len(names) + "|"]


BLOCKS = {"results": tables, "judged": judged, "procedural": procedural, "causes": causes}
"""What stands between `<!-- NAME -->` and `<!-- /NAME -->` on the page."""


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
    for block, text in BLOCKS.items():
        block_writer(goal, block)(text(goal))
    draw_reliability(goal.resolve().parents[1])

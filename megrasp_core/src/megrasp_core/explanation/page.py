"""An explanation as a page with pictures, and as JSON."""

from __future__ import annotations

import json
from collections import Counter
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.drawing.near_miss_picture import save_near_miss_picture
from megrasp_core.drawing.reason_colours import reason_colour
from megrasp_core.drawing.synthesis_map import save_synthesis_map
from megrasp_core.lie import pose7_from_matrix

from .explain import Explanation
from .near_miss import NearMiss

__all__ = ["write_explanation"]

SHOWN = 10
"""Grasps in the table of the page."""
MAP = "map.png"
MEANINGS = {
    "workspace": "the TCP is outside the region",
    "tilt": "steeper than max_tilt",
    "collision": "the open gripper hits something, there or on the way",
    "unseen": "too much of the gripper is where nothing was seen",
    "empty": "nothing is between the fingers",
    "sweep": "the fingers hit something while they close",
    "object": "another object than the target",
    "excluded": "failed before",
    "score": "less than min_score",
    "duplicate": "repeats a better grasp",
    "surplus": "good, but more were found than asked for",
    "unrefined": "looked at coarsely only: others promised more",
}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1180px; margin: 2em auto; padding: 0 1em;
       color: #222; }
h1 { font-size: 1.4em; } h2 { font-size: 1.15em; margin-top: 1.8em; }
img { max-width: 100%; border: 1px solid #ddd; }
table { border-collapse: collapse; } td, th { padding: .25em .8em; text-align: left;
        border-bottom: 1px solid #ddd; }
.cause { background: #fdf3d8; border-left: 5px solid #e0b000; padding: .7em 1em; }
.dot { display: inline-block; width: .8em; height: .8em; border-radius: 50%; }
.small { color: #666; font-size: .9em; }
"""


def write_explanation(explanation: Explanation, folder: str | Path, frame: str = "world") -> Path:
    """Write explanation.json, explanation.html and its pictures into a folder, which is made.

    Args:
        explanation: of a synthesis.
        folder: files of an explanation in it are replaced.
        frame: name of the cloud's frame.

    Returns:
        The path of the page.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("near_miss_*.png"):
        old.unlink()
    save_synthesis_map(
        folder / MAP,
        explanation.cloud,
        explanation.request,
        trace=explanation.trace,
        grasps=explanation.returned,
        found=explanation.setup.found,
        title=_headline(explanation),
        lines=[f"{number}. {text}" for number, text in enumerate(explanation.causes[:4], 1)],
    )
    counts = _counts(explanation)
    for miss in explanation.misses:
        _draw(explanation, miss, counts, folder / _picture(miss))
    content = _content(explanation, counts, frame)
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    (folder / "explanation.json").write_text(text)
    page = folder / "explanation.html"
    page.write_text(_page(explanation, counts))
    return page


def _headline(explanation: Explanation) -> str:
    name = explanation.gripper.description.display_name
    if explanation.answer is None:
        return f"{name}: nothing was synthesized"
    drawn = explanation.answer.drawn
    return f"{name}: {len(explanation.returned)} grasps returned, {drawn} poses drawn"


def _counts(explanation: Explanation) -> dict[str, int]:
    """Poses per reason, the most frequent first; those returned are not among them."""
    if explanation.trace is None or explanation.trace.assessment is None:
        return {}
    reasons = explanation.trace.assessment.check.reason.tolist()
    return dict(Counter(reason for reason in reasons if reason).most_common())


def _picture(miss: NearMiss) -> str:
    return f"near_miss_{miss.reason}.png"


def _draw(explanation: Explanation, miss: NearMiss, counts: dict[str, int], path: Path) -> None:
    request, trace = explanation.request, explanation.trace
    assert trace is not None
    up = request.gravity
    save_near_miss_picture(
        path,
        explanation.cloud,
        explanation.gripper,
        miss.world_from_gripper,
        share=miss.share,
        points=miss.points,
        state=miss.state,
        up=trace.observation.sensor - miss.world_from_gripper[:3, 3]
        if up is None
        else -np.asarray(up),
        region=request.region,
        lines=(f"{miss.reason}, the nearest of {counts[miss.reason]} to a grasp", miss.how),
    )


def _content(explanation: Explanation, counts: dict[str, int], frame: str) -> dict[str, Any]:
    answer, trace, causes = explanation.answer, explanation.trace, explanation.causes
    content: dict[str, Any] = {
        "frame": frame,
        "gripper": explanation.gripper.name,
        "cause": _main_cause(explanation),
        "causes": list(causes),
        "refused": bool(explanation.refusal),
        "notes": list(answer.notes) if answer else [],
        "map": MAP,
    }
    if answer is None or trace is None:
        return content
    content |= {
        "model": answer.model,
        "seed": answer.seed,
        "drawn": answer.drawn,
        "grasps": [
            {**grasp.to_json(), "score_terms": explanation.terms(grasp)}
            for grasp in explanation.returned
        ],
        "reasons": {
            reason: {"count": count, "meaning": MEANINGS.get(reason, "")}
            for reason, count in counts.items()
        },
        "poses": [],
    }
    assessed = trace.assessment
    if assessed is None:
        return content
    for miss in explanation.misses:
        at = miss.world_from_gripper.copy()
        at[:3, 3] += trace.offset
        content["reasons"][miss.reason]["near_miss"] = {
            "world_from_gripper": _pose(at),
            "how": miss.how,
            "pose": miss.row,
            "score": round(float(assessed.score[miss.row]), 4),
            "points": [_numbers(point + trace.offset) for point in miss.points],
            "picture": _picture(miss),
        }
    for row, (start, drawn) in enumerate(zip(trace.starts, trace.drawn, strict=True)):
        ranked = assessed.poses.tcp[row].copy()
        sampled = drawn.copy()
        ranked[:3, 3] += trace.offset
        sampled[:3, 3] += trace.offset
        content["poses"].append(
            {
                "start": _numbers(start + trace.offset),
                "world_from_tcp_drawn": _pose(sampled),
                "world_from_tcp": _pose(ranked),
                "reason": str(assessed.check.reason[row]),
                "score": round(float(assessed.score[row]), 4),
            }
        )
    return content


def _main_cause(explanation: Explanation) -> str:
    """The likeliest cause of having no grasps; with grasps, only what is wrong with the setup."""
    causes = explanation.setup.told if explanation.returned else explanation.causes
    return causes[0] if causes else ""


def _page(explanation: Explanation, counts: dict[str, int]) -> str:
    head = escape(_headline(explanation))
    parts = [
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{head}</title>"
        f"<style>{STYLE}</style></head><body><h1>{head}</h1>"
    ]
    cause = _main_cause(explanation)
    if cause:
        parts.append(f"<p class='cause'><b>Most likely:</b> {escape(cause)}</p>")
    others = [text for text in explanation.causes if text != cause]
    notes = list(explanation.answer.notes) if explanation.answer else []
    if others or notes:
        lines = "".join(f"<li>{escape(text)}</li>" for text in (*others, *notes))
        parts.append(f"<ul>{lines}</ul>")
    parts.append(f"<p><a href='{MAP}'><img src='{MAP}' alt='map of the synthesis'></a></p>")
    if explanation.returned:
        parts.append(_grasps(explanation))
    if counts:
        parts.append(_reasons(explanation, counts))
    if explanation.answer is not None:
        answer = explanation.answer
        parts.append(
            f"<p class='small'>model {escape(answer.model)}, gripper "
            f"{escape(answer.gripper)}, seed {answer.seed}, {answer.timing['total']:.2f} s. All "
            "numbers and every pose: <a href='explanation.json'>explanation.json</a>.</p>"
        )
    return "\n".join([*parts, "</body></html>\n"])


def _grasps(explanation: Explanation) -> str:
    rows = []
    for rank, grasp in enumerate(explanation.returned[:SHOWN], start=1):
        terms = explanation.terms(grasp)

        def cell(text: str, name: str, terms: dict[str, float] = terms) -> str:
            term = f" <span class='small'>{terms[name]:+.1f}</span>" if name in terms else ""
            return f"<td>{text}{term}</td>"

        width = f"{1000 * grasp.width:.0f} mm" if np.isfinite(grasp.width) else "-"
        tilt = f"{np.degrees(grasp.tilt):.0f}&deg;" if np.isfinite(grasp.tilt) else "-"
        rows.append(
            f"<tr><td>{rank}</td>"
            + cell(f"<b>{grasp.score:.2f}</b>", "bias")
            + cell(f"{grasp.confidence:.2f}", "confidence")
            + cell(f"{1000 * grasp.clearance:.1f} mm", "clearance")
            + cell(f"{100 * grasp.hidden_share:.1f} %", "hidden")
            + cell(tilt, "tilt")
            + f"<td>{width}</td></tr>"
        )
    return (
        "<h2>Why these grasps</h2><table><tr><th></th><th>score</th><th>confidence of the model"
        "</th><th>clearance</th><th>in unknown space</th><th>tilt</th><th>width</th></tr>"
        + "".join(rows)
        + "</table><p class='small'>Small numbers: what each adds to the logit of the score, "
        "which begins with the one beside the score.</p>"
    )


def _reasons(explanation: Explanation, counts: dict[str, int]) -> str:
    misses = {miss.reason: miss for miss in explanation.misses}
    rows = "".join(
        f"<tr><td><span class='dot' style='background:{reason_colour(reason)}'></span></td>"
        f"<td>{escape(reason)}</td><td>{count}</td><td>{escape(MEANINGS.get(reason, ''))}</td>"
        f"<td>{escape(misses[reason].how) if reason in misses else ''}</td></tr>"
        for reason, count in counts.items()
    )
    pictures = "".join(
        f"<p><img src='{_picture(miss)}' alt='{escape(miss.reason)}'></p>"
        for miss in explanation.misses
    )
    return (
        "<h2>Why not there</h2><table><tr><th></th><th>reason</th><th>poses</th><th>meaning</th>"
        f"<th>the nearest miss</th></tr>{rows}</table>{pictures}"
    )


def _numbers(values: np.ndarray) -> list[float]:
    return [round(float(value), 6) for value in values]


def _pose(matrix: np.ndarray) -> list[float]:
    return _numbers(pose7_from_matrix(matrix))

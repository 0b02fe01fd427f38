"""How often and how well bins are found in simulated clouds (`megrasp bench --stage bins`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import NoBinError
from megrasp_core.evaluation.report import hardware
from megrasp_core.evaluation.statistics import wilson
from megrasp_core.pointcloud import FoundBin, OrientedBox, find_bin

from .bin_scenes import BinScene, bin_scene, table_scene

FloatArray = NDArray[np.float64]

POSITION, ANGLE = 0.005, 1.0
"""Found right: the middle of the opening and the axes are nearer than this (m, degrees)."""
GROUPS = (
    ("empty", "few", "half", "full", "overfull"),
    ("from above", "oblique"),
    ("default", "structured_light", "stereo"),
    ("tilted", "drafted", "ledge", "second bin", "boxes beside", "wall unseen", "floor unseen"),
)
"""Features that get a row each: fill, view, camera, the rest."""


def bench_bins(
    scenes: int,
    seed: int,
    *,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Look for the bin in `scenes` clouds with one, and in as many of tables.

    Args:
        scenes: of either kind.
        seed: of the first; the others follow.
        on_progress: called with clouds done and in all.

    Returns:
        Content of the result file. A row for each cloud: what was special of it, whether a bin was
        found, how far (m) the middle of its opening is from the true one and the angle (degrees)
        of the whole pose, errors of the inner edges and the depth (m), of the fill level, and
        CPU-seconds. Where a scene has two bins either may be found; a bin turned by a quarter or
        half is the same bin.
    """
    bins: list[dict[str, Any]] = []
    tables: list[dict[str, Any]] = []
    redrawn = 0
    for index in range(scenes):
        scene, before = bin_scene(seed + index)
        redrawn += before
        bins.append({"seed": seed + index, **_looked(scene)})
        tables.append({"seed": seed + index, **_looked(table_scene(seed + index))})
        if on_progress is not None:
            on_progress(2 * (index + 1), 2 * scenes)
    return {
        "stage": "bins",
        "scenes": scenes,
        "seed": seed,
        "redrawn": redrawn,
        "limits": {"position": POSITION, "angle": ANGLE},
        "right": _rate(bins, "right"),
        "false": _rate(tables, "found"),
        "cpu_seconds": _spread([row["cpu"] for row in bins]),
        "points": _spread([row["points"] for row in bins]),
        "bins": bins,
        "tables": tables,
        "hardware": hardware(),
    }


def _looked(scene: BinScene) -> dict[str, Any]:
    start = time.process_time()
    try:
        found = find_bin(scene.cloud, scene.gravity)
    except NoBinError:
        found = None
    row: dict[str, Any] = {
        "features": list(scene.features),
        "points": len(scene.cloud),
        "found": found is not None,
        "right": False,
        "cpu": round(time.process_time() - start, 3),
    }
    if found is None or not scene.boxes:
        return row
    errors = [pose_error(found.box, box) for box in scene.boxes]
    which = int(np.argmin([distance for distance, _, _ in errors]))
    distance, angle, size = errors[which]
    row |= {
        "right": bool(distance < POSITION and angle < ANGLE),
        "position": round(distance, 5),
        "angle": round(angle, 3),
        "edges": [round(float(error), 5) for error in size],
        "depth_from": found.depth_from,
    }
    return row | (_content(found, scene) if which == 0 else {})


def _content(found: FoundBin, scene: BinScene) -> dict[str, Any]:
    fill = found.fill_level - scene.fill
    return {
        "fill": round(fill, 4) if np.isfinite(fill) else None,
        "empty": [found.empty, scene.empty],
    }


def pose_error(found: OrientedBox, true: OrientedBox) -> tuple[float, float, FloatArray]:
    """Distance (m) of the middles of the upper faces, angle (degrees) of the rotation between the
    boxes, and difference of the edges (3,) in m, over the four turns of a box about its z.
    """
    tops = [box.centre + box.rotation[:, 2] * box.size[2] / 2 for box in (found, true)]
    distance = float(np.linalg.norm(tops[0] - tops[1]))
    best, size = np.inf, true.size
    for quarter in range(4):
        c, s = (1, 0, -1, 0)[quarter], (0, 1, 0, -1)[quarter]
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        between = found.rotation.T @ true.rotation @ turn
        angle = np.degrees(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1)))
        if angle < best:
            best, size = float(angle), true.size[[1, 0, 2]] if quarter % 2 else true.size
    return distance, best, found.size - size


def _rate(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any]:
    return wilson(sum(bool(row[key]) for row in rows), len(rows)).to_json()


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {
        "median": round(float(np.median(values)), 4),
        "p95": round(float(np.percentile(values, 95)), 4),
        "max": round(float(max(values)), 4),
    }


def bin_tables(content: Mapping[str, Any]) -> str:
    """The result as markdown: a row for each feature."""
    lines = [
        "| clouds | right | not found | wrong | position mm, median and p95 | angle degrees | "
        "edges mm, p95 | depth mm, p95 | fill level, p95 | empty told right |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        _line("all with a bin", content["bins"]),
    ]
    for group in GROUPS:
        for name in group:
            rows = [row for row in content["bins"] if name in row["features"]]
            if rows:
                lines.append(_line(name, rows))
    wrong, cpu = content["false"], content["cpu_seconds"]
    low, high = content["right"]["ci95"]
    lines += [
        "",
        f"Right in {content['right']['successes']} of {content['right']['trials']} "
        f"({100 * low:.1f} to {100 * high:.1f} %, Wilson). On tables without a bin: "
        f"{wrong['successes']} of {wrong['trials']} clouds. CPU-seconds for "
        f"{content['points']['median']:,.0f} points: median {cpu['median']:.2f}, 95 % below "
        f"{cpu['p95']:.2f}. {content['redrawn']} scenes were drawn again because fewer than three "
        f"walls were seen. {content['hardware']['cpu']}.",
    ]
    return "\n".join(lines) + "\n"


def _line(name: str, rows: Sequence[Mapping[str, Any]]) -> str:
    good = [row for row in rows if row["right"]]
    right, lost = len(good), sum(not row["found"] for row in rows)

    def p(values: list[float], share: float, form: str) -> str:
        return format(float(np.percentile(values, share)), form) if values else "-"

    place = [1000 * row["position"] for row in good]
    angle = [row["angle"] for row in good]
    edges = [1000 * max(abs(edge) for edge in row["edges"][:2]) for row in good]
    depth = [1000 * abs(row["edges"][2]) for row in good]
    fill = [abs(row["fill"]) for row in good if row.get("fill") is not None]
    told = [row["empty"][0] == row["empty"][1] for row in good if "empty" in row]
    return (
        f"| {name} | {right} of {len(rows)} | {lost} | {len(rows) - right - lost} | "
        f"{p(place, 50, '.1f')}, {p(place, 95, '.1f')} | {p(angle, 50, '.2f')}, "
        f"{p(angle, 95, '.2f')} | {p(edges, 95, '.1f')} | {p(depth, 95, '.1f')} | "
        f"{p(fill, 95, '.2f')} | {sum(told)} of {len(told)} |"
    )

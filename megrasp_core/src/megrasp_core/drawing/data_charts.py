"""Charts of what lies in a data set: yields, sizes, how many grippers can grasp each object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from megrasp_core.library import ObjectFacts

__all__ = ["draw_grippers_per_object", "draw_objects", "draw_scene_stats", "draw_yield"]

DPI = 100
SCANS, PROCEDURAL = "scans", "procedural"
COLOURS = {SCANS: "#4c78a8", PROCEDURAL: "#f2a541"}
HELD, DRAWN = "#3b8f5a", "#a8c8b0"
MASS_TICKS = [a * 10.0**b for b in range(5) for a in (1, 2, 5)]
ROW = 0.42
"""Height of a gripper's row (inches)."""


def draw_yield(stats: Mapping[str, Any], path: Path) -> Path:
    """Bars for each gripper of `library_stats`: share of objects held, yield of what was drawn."""
    grippers = stats["grippers"]
    share = {n: g["objects_with_success"] / max(1, g["objects"]) for n, g in grippers.items()}
    names = sorted(grippers, key=lambda n: (share[n], grippers[n]["yield"] or 0.0))
    figure = _figure(8.0, 1.6 + ROW * len(names))
    axes = figure.add_subplot()
    rows = np.arange(len(names))
    for offset, colour, label, values, notes in (
        (
            0.2,
            HELD,
            "objects with any success",
            [share[n] for n in names],
            [f"{grippers[n]['objects_with_success']} of {grippers[n]['objects']}" for n in names],
        ),
        (
            -0.2,
            DRAWN,
            "successes of all grasps drawn",
            [grippers[n]["yield"] or 0.0 for n in names],
            [f"{grippers[n]['successes']} of {grippers[n]['drawn']}" for n in names],
        ),
    ):
        axes.barh(rows + offset, 100.0 * np.array(values), 0.4, color=colour, label=label)
        for row, value, note in zip(rows + offset, values, notes):
            axes.text(100.0 * value + 1, row, note, va="center", fontsize=7.5, color="#444444")
    axes.set_yticks(rows, names)
    axes.set_xlim(0, 122)
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("%")
    _plain(axes, "x")
    figure.suptitle(f"Free-space grasps of {stats['objects']} objects")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return _save(figure, path)


def draw_grippers_per_object(stats: Mapping[str, Any], path: Path) -> Path:
    """Histogram of the number of grippers with a success on an object, of the objects that were
    labelled for every gripper.
    """
    count = len(stats["grippers"])
    done = {n: e["able"] for n, e in stats["grippers_able"].items() if e["labelled"] == count}
    figure = _figure(8.0, 3.8)
    axes = figure.add_subplot()
    base = np.zeros(count + 1)
    for kind in (SCANS, PROCEDURAL):
        able = [n for name, n in done.items() if _kind(name) == kind]
        heights = np.bincount(able, minlength=count + 1) if able else np.zeros(count + 1)
        label = f"{kind} ({len(able)})"
        axes.bar(np.arange(count + 1), heights, 0.8, base, color=COLOURS[kind], label=label)
        base = base + heights
    for place, height in enumerate(base):
        if height:
            axes.text(place, height, f"{height:.0f}", ha="center", va="bottom", fontsize=8)
    axes.set_xticks(range(count + 1))
    axes.set_ylim(0, 1.12 * max(1.0, base.max()))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel(f"grippers able to grasp the object (of {count})")
    axes.set_ylabel("objects")
    _plain(axes, "y")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    left = stats["objects"] - len(done)
    note = f"; {left} not yet labelled for every gripper are left out" if left else ""
    figure.suptitle(f"{len(done)} objects{note}", fontsize=11)
    return _save(figure, path)


def draw_objects(facts: Sequence[ObjectFacts], missing: Sequence[str], path: Path) -> Path:
    """Histograms of size and mass; the title tells how many objects are `missing`."""
    figure = _figure(10.0, 3.6)
    kinds = [_kind(fact.name) for fact in facts]
    extents = 1000.0 * np.array([fact.extents for fact in facts]).reshape(-1, 3)
    mass = 1000.0 * np.array([fact.mass for fact in facts])
    for place, (values, label, logarithmic) in enumerate(
        (
            (extents[:, 2], "largest edge (mm)", False),
            (extents[:, 0], "smallest edge (mm)", False),
            (mass, "mass (g)", True),
        )
    ):
        axes = figure.add_subplot(1, 3, place + 1)
        if len(values):
            low, high = 0.99 * values.min(), 1.01 * values.max()
            edges = np.geomspace(low, high, 21) if logarithmic else np.linspace(0.0, high, 21)
            parts = [
                values[np.array([kind == wanted for kind in kinds])]
                for wanted in (SCANS, PROCEDURAL)
            ]
            axes.hist(
                parts,
                edges.tolist(),
                stacked=True,
                color=list(COLOURS.values()),
                label=[f"{k} ({len(p)})" for k, p in zip(COLOURS, parts)],
            )
            axes.axvline(float(np.median(values)), color="#444444", lw=1, ls="--")
            if logarithmic:
                axes.set_xscale("log")
                ticks = [tick for tick in MASS_TICKS if low <= tick <= high]
                axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
                axes.set_xticks([], minor=True)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(label)
        _plain(axes, "y")
        if place == 0:
            axes.set_ylabel("objects")
            if len(values):
                figure.legend(loc="outside lower center", ncols=2, frameon=False)
    left = f"; {len(missing)} could not be loaded and are left out" if missing else ""
    figure.suptitle(f"{len(facts)} objects, median dashed{left}", fontsize=11)
    return _save(figure, path)


def draw_scene_stats(stats: Mapping[str, Any], path: Path) -> Path:
    """Bars for each gripper of `scene_stats`: successes per scene, and why library grasps that
    were tried in the heap failed.
    """
    grippers = stats["grippers"]
    names = sorted(grippers, key=lambda n: grippers[n]["successes_per_scene"])
    reasons = sorted({reason for g in grippers.values() for reason in g["judged_failures"]})
    figure = _figure(10.0, 1.6 + ROW * len(names))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    values = [grippers[name]["successes_per_scene"] for name in names]
    left.barh(names, values, 0.6, color=HELD)
    left.set_xlabel("successes a scene")
    base = np.zeros(len(names))
    tab = ("#d62728", "#ff9f40", "#4c78a8", "#b07aa1", "#8c6d5a", "#59a14f", "#9aa5b1", "#e7c84e")
    for index, reason in enumerate(reasons):
        counts = np.array([grippers[name]["judged_failures"].get(reason, 0) for name in names])
        right.barh(names, counts, 0.6, base, color=tab[index % len(tab)], label=reason)
        base = base + counts
    right.set_yticks(range(len(names)), [""] * len(names))
    right.set_xlabel("grasps that failed in the heap")
    for axes in (left, right):
        _plain(axes, "x")
    if reasons:
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{stats['scenes']} scenes, {stats['mean_objects']:.1f} objects on average")
    return _save(figure, path)


def _kind(name: str) -> str:
    return SCANS if name.startswith("asset/") else PROCEDURAL


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _plain(axes: Axes, grid: str) -> None:
    axes.grid(axis=grid, alpha=0.3)  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _save(figure: Figure, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path

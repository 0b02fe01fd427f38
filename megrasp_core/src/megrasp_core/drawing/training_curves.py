"""Loss curves of a run as a picture."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = {"per_gripper": "diffusion, by gripper", "per_band": "diffusion, by band of noise"}
"""Validation losses that are kept in parts, and what their panels are called."""


def plot_curves(losses: Path, picture: Path) -> None:
    """Draw the losses over the poses seen: training and validation, then the diffusion's
    validation by gripper and by band of noise.

    Args:
        losses: `losses.jsonl` of a run.
        picture: PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lines = read_losses(losses)
    names = sorted({k.split("_", 1)[1] for line in lines for k in line if k.startswith("train_")})
    parts = [name for name in PARTS if any(line.get(name) for line in lines)]
    panels = len(names) + len(parts)
    figure = Figure(figsize=(4.0 * max(1, panels), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    for place, name in enumerate(names):
        axes = figure.add_subplot(1, panels, place + 1)
        for part in ("train", "validation"):
            _curve(axes, lines, part, (line.get(f"{part}_{name}") for line in lines))
        _finish(axes, name)
    for place, name in enumerate(parts):
        axes = figure.add_subplot(1, panels, len(names) + place + 1)
        for key in sorted({key for line in lines for key in line.get(name, {})}):
            _curve(axes, lines, key, (line.get(name, {}).get(key) for line in lines))
        _finish(axes, PARTS[name])
    figure.savefig(picture, dpi=110)


def plot_forecast(
    losses: Path, poses: np.ndarray, law: np.ndarray, error: np.ndarray, picture: Path
) -> None:
    """Draw the diffusion's validation losses of a run and a law that goes on from them.

    Args:
        losses: `losses.jsonl` of a run.
        poses: (N,) seen in training, to draw the law at.
        law: (N,) loss there.
        error: (N,) its standard error, drawn twice to both sides.
        picture: PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.fill_between(poses / 1e6, law - 2 * error, law + 2 * error, alpha=0.2, linewidth=0)
    axes.plot(poses / 1e6, law, label="power law, twice its standard error")
    measured = [
        (line["poses"] / 1e6, line["validation_diffusion"])
        for line in read_losses(losses)
        if line.get("validation_diffusion") is not None
    ]
    axes.plot(*zip(*measured, strict=True), "k.", label="validation")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    _finish(axes, "diffusion loss")
    figure.savefig(picture, dpi=110)


def read_losses(losses: Path) -> list[dict[str, Any]]:
    """Lines of a run's `losses.jsonl`, oldest first, without one that a kill cut off."""
    lines = []
    for line in losses.read_text().splitlines():
        with contextlib.suppress(json.JSONDecodeError):
            lines.append(json.loads(line))
    return lines


def append_losses(losses: Path, line: dict[str, Any]) -> None:
    """Add a line to a run's `losses.jsonl`, on a line of its own even after a kill."""
    whole = not losses.exists() or losses.read_bytes()[-1:] in (b"", b"\n")
    with losses.open("a") as file:
        file.write(("" if whole else "\n") + json.dumps(line) + "\n")


def _curve(
    axes: Axes, lines: list[dict[str, Any]], label: str, values: Iterable[float | None]
) -> None:
    """One curve over millions of poses; in training of the heads, of labelled poses."""
    points = [
        ((line["poses"] or line["labelled_poses"]) / 1e6, value)
        for line, value in zip(lines, values, strict=True)
        if value is not None
    ]
    if points:
        axes.plot(*zip(*points, strict=True), label=label)


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title)
    axes.set_xlabel("million poses")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=6 if len(axes.lines) > 4 else 9, ncols=2 if len(axes.lines) > 4 else 1)

"""Loss curves of a run as a picture."""

from __future__ import annotations

import json
from pathlib import Path


def plot_curves(losses: Path, picture: Path) -> None:
    """Draw the training and validation losses over the poses seen.

    Args:
        losses: `losses.jsonl` of a run.
        picture: PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lines = [json.loads(line) for line in losses.read_text().splitlines()]
    names = sorted({k.split("_", 1)[1] for line in lines for k in line if k.startswith("train_")})
    figure = Figure(figsize=(4.0 * max(1, len(names)), 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    for place, name in enumerate(names):
        axes = figure.add_subplot(1, len(names), place + 1)
        for part in ("train", "validation"):
            points = [
                (line["steps"], line[f"{part}_{name}"])
                for line in lines
                if f"{part}_{name}" in line
            ]
            if points:
                axes.plot(*zip(*points), label=part)
        axes.set_title(name)
        axes.set_xlabel("steps")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(picture, dpi=110)

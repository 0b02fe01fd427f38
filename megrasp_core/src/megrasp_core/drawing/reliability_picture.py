"""How far scores are to be trusted, as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["save_reliability_picture"]


def save_reliability_picture(report: Mapping[str, Any], picture: Path) -> None:
    """Draw the share of grasps that held over the score that they had, in scenes left out of the
    fit: of all grippers, then of every kind.

    Args:
        report: of `megrasp calibrate`, its rows of `reliability` with their `ci95`.
        picture: PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    parts = {"all grippers": report, **report.get("kinds", {})}
    figure = Figure(figsize=(3.0 * len(parts), 3.3), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (name, part) in enumerate(parts.items()):
        axes = figure.add_subplot(1, len(parts), place + 1)
        _diagram(axes, part)
        auc = part["held_out"]["auc"]
        axes.set_title(f"{name}" + ("" if auc is None else f", AUC {auc:.2f}"), fontsize=10)
        if place == 0:
            axes.set_ylabel("share that held")
    figure.suptitle(f"{report['model']}: {_counts(report)}", fontsize=10)
    figure.savefig(picture, dpi=110)


def _counts(report: Mapping[str, Any]) -> str:
    """How many grasps of how many grippers, for a title."""
    judged = sum(counts["judged"] for counts in report["grippers"].values())
    return f"{judged} executed grasps of {len(report['grippers'])} grippers"


def _diagram(axes: Axes, part: Mapping[str, Any]) -> None:
    axes.plot([0, 1], [0, 1], color="0.8", linewidth=1)
    for row in part["reliability"]:
        low, high = row["ci95"]
        axes.plot([row["predicted"]] * 2, [low, high], color="tab:blue", linewidth=1)
        axes.plot(row["predicted"], row["observed"], "o", color="tab:blue", markersize=5)
        axes.annotate(
            str(row["count"]), (row["predicted"], row["observed"]), fontsize=7, color="0.3",
            xytext=(5, -9), textcoords="offset points",
        )  # fmt: skip
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="score", aspect="equal")

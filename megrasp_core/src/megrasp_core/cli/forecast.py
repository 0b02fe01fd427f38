"""What more computing would bring to a run whose rate does not fall, from its own losses:
`python -m megrasp_core.cli.forecast models/megrasp-base/losses.jsonl docs/results/forecast.json`.

Beside the JSON file lies a picture of the same name. How far the law is to be trusted is seen from
what it says of the run's second half when it knows the first half alone.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.drawing.training_curves import plot_forecast, read_losses
from megrasp_core.training.forecast import LossCurve, fit_curve

from .common import emit

FIRST = 1e6
CORE_HOURS = (10, 100, 1000)


def forecast(lines: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Any], LossCurve]:
    """The law, what it says of more core-hours, and what its first half says of the second."""
    end = lines[-1]
    poses, per_second = end["poses"], end["poses"] / end["cpu_seconds"]
    curve, half = fit_curve(lines, FIRST), fit_curve(lines, FIRST, poses / 2)
    return {
        "what": "limit + gain n^-exponent of the diffusion's validation loss, n million poses",
        "fitted_from_poses": FIRST,
        "limit": round(curve.limit, 4),
        "gain": round(curve.gain, 4),
        "exponent": round(curve.exponent, 3),
        "residual": round(curve.residual, 5),
        "poses": poses,
        "loss": end["validation_diffusion"],
        "poses_per_cpu_second": round(per_second, 1),
        "first_half_says": _at(half, poses),
        "more": [
            {"core_hours": hours, **_at(curve, poses + 3600 * hours * per_second)}
            for hours in CORE_HOURS
        ],
    }, curve


def _at(curve: LossCurve, poses: float) -> dict[str, Any]:
    """The loss there, and its standard error."""
    return {
        "poses": round(poses),
        "loss": round(curve.at(poses), 4),
        "standard_error": round(curve.error(poses), 4),
    }


if __name__ == "__main__":
    losses, out = map(Path, sys.argv[1:])
    content, law = forecast(read_losses(losses))
    emit({"losses": str(losses), **content}, out)
    poses = np.geomspace(FIRST, content["more"][1]["poses"], 200)
    values = np.array([law.at(n) for n in poses])
    errors = np.array([law.error(n) for n in poses])
    plot_forecast(losses, poses, values, errors, out.with_suffix(".png"))

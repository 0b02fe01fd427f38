"""A picture of a gripper: both postures from three sides, with its frame and TCP (`megrasp gripper
render`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper

VIEWS = ((0, 2, 1, "from -Y"), (1, 2, 0, "from +X"), (0, 1, 2, "from +Z"))
COLOURS = {0: "tab:red", 1: "tab:green", 2: "tab:blue"}
POINTS = 3000
AXIS_LENGTH = 0.03


def gripper_picture(gripper: Gripper, file: str | Path) -> Path:
    """Write a PNG with the open and the closed outer cloud, the gripper frame and the TCP; return
    its path.
    """
    clouds = gripper.clouds(POINTS)
    figure = Figure(figsize=(15, 11), layout="constrained")
    axes = figure.subplots(2, 3)
    rows = (
        ("open", clouds.open_points, clouds.open_normals),
        ("closed", clouds.closed_points, clouds.closed_normals),
    )
    both = np.concatenate([clouds.open_points, clouds.closed_points])
    low, high = both.min(axis=0) - 0.01, both.max(axis=0) + 0.01
    for row, (posture, points, normals) in zip(axes, rows, strict=True):
        for axis, (h, v, depth, title) in zip(row, VIEWS, strict=True):
            # Seen from -Y the nearest points have the smallest y, else the largest coordinate is
            # nearest.
            sign = -1.0 if depth == 1 else 1.0
            _scatter(axis, points, normals, (h, v, depth), sign)
            _frame(axis, np.zeros(3), h, v, "gripper")
            axis.plot(
                *gripper.tcp[[h, v]], marker="+", color="black", markersize=14, markeredgewidth=2
            )
            axis.annotate("TCP", gripper.tcp[[h, v]], xytext=(6, 6), textcoords="offset points")
            axis.set(
                title=f"{posture}, {title}",
                aspect="equal",
                xlabel=f"{'xyz'[h]} (m)",
                ylabel=f"{'xyz'[v]} (m)",
                xlim=(low[h], high[h]),
                ylim=(low[v], high[v]),
            )
            axis.grid(alpha=0.3)
    width = gripper.description.max_width
    size = "" if width is None else f", opens {1000 * width:.0f} mm"
    figure.suptitle(
        f"{gripper.description.display_name} ({gripper.name}){size}; +Z approach, +X closing"
    )
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    return path


def _scatter(
    axis: Axes,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    order: tuple[int, int, int],
    sign: float,
) -> None:
    """Draw the points that face the viewer, far ones first, shaded by their normals."""
    h, v, depth = order
    facing = sign * normals[:, depth] > -0.05
    points, normals = points[facing], normals[facing]
    nearest_last = np.argsort(sign * points[:, depth])
    light = np.zeros(3)
    light[[h, v, depth]] = (-0.4, 0.5, 0.77 * sign)
    shade = 0.25 + 0.65 * np.clip(normals @ light, 0.0, 1.0)
    axis.scatter(
        points[nearest_last, h],
        points[nearest_last, v],
        c=np.repeat(shade[nearest_last, None], 3, axis=1),
        s=9,
        linewidths=0,
    )


def _frame(axis: Axes, origin: NDArray[np.float64], h: int, v: int, name: str) -> None:
    for index, colour in COLOURS.items():
        end = origin.copy()
        end[index] += AXIS_LENGTH
        if index in (h, v):
            axis.annotate(
                "",
                xy=(end[h], end[v]),
                xytext=(origin[h], origin[v]),
                arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 2.5},
            )
    axis.annotate(name, (origin[h], origin[v]), xytext=(6, -12), textcoords="offset points")

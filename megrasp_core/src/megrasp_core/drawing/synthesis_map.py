"""A map of one synthesis: what was seen, where the poses began and ended, what became of them."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.ranking import PointState

from .reason_colours import RETURNED, reason_colour
from .splat import height_colours

if TYPE_CHECKING:
    from megrasp_core.synthesizer import RankedGrasp, SynthesisRequest, Trace

__all__ = ["save_synthesis_map"]

FloatArray = NDArray[np.float64]

CELLS = 260
"""Of the longer edge of the map."""
AROUND = 0.06
"""So much is drawn around the region (m)."""
ON_FLOOR = 0.006
"""What is seen nearer to the floor than this is floor (m)."""
LOW = 0.010
"""Over the floor (m): where this is unknown, nothing is known of what stands there."""
STEM = 0.05
"""Length of the line that shows where a pose comes from (m)."""
NUMBERED = 6
BAR = 0.03
"""Length of the bar of a grasp without a width (m)."""
FLOOR, BELOW = (0.80, 0.87, 0.93), (0.85, 0.55, 0.50)
UNKNOWN, OUTSIDE = (0.76, 0.66, 0.86), (0.97, 0.97, 0.97)
FOUND = "#0a7d4f"


@dataclass(frozen=True)
class _Plan:
    """The axes of the map: rows x and y on it, and up."""

    rotation: FloatArray
    centre: FloatArray
    low: FloatArray
    high: FloatArray
    floor: float | None

    def at(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) in the axes of the map (m)."""
        return (points - self.centre) @ self.rotation.T


def save_synthesis_map(
    path: str | Path,
    cloud: Cloud,
    request: SynthesisRequest,
    *,
    trace: Trace | None = None,
    grasps: Sequence[RankedGrasp] = (),
    found: OrientedBox | None = None,
    title: str = "",
    lines: Sequence[str] = (),
) -> Path:
    """Write the map to a PNG; missing folders are made.

    From above: heights of what was seen, floor, unknown space, region; a line from where each pose
    began to where it ended, coloured by what became of it; returned grasps as bars along the
    closing axis, with rank and score. From the side: the same, with where the poses come from.

    Args:
        path: PNG to write.
        cloud: in the coordinates of the trace.
        request: in the same.
        trace: of the synthesis; None where it was refused: then the cloud and the region alone.
        grasps: returned, best first, in the frame of the trace plus its offset.
        found: inside of the bin that the cloud shows.
        title: first line.
        lines: sentences to stand in the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    plan = _plan(cloud, request, trace, found)
    figure = Figure(figsize=(15.0, 13.0), dpi=90)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        2, 2, height_ratios=(3, 2), left=0.05, right=0.985, top=0.92, bottom=0.05,
        hspace=0.28, wspace=0.12,
    )  # fmt: skip
    seen, drawn = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    side, words = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    picture, low, high = _heights(cloud, plan, trace)
    extent = (plan.low[0], plan.high[0], plan.low[1], plan.high[1])
    seen.imshow(picture, origin="lower", extent=extent, interpolation="nearest")
    pale = 0.55 + 0.45 * picture.mean(axis=2, keepdims=True).repeat(3, axis=2)
    drawn.imshow(pale, origin="lower", extent=extent, interpolation="nearest")
    for axes in (seen, drawn):
        _draw_region(axes, plan, request, found, names=axes is seen)
        axes.set_xlabel("x of the region (m)" if request.region is not None else "x (m)")
        axes.set_ylabel("y (m)")
    seen.set_title("What was seen, from above", loc="left", fontsize=12)
    drawn.set_title("Where the poses began (rings) and ended (dots)", loc="left", fontsize=12)
    _height_legend(seen, low, high, request, found)
    _draw_side(side, cloud, plan, request, found)
    if trace is not None and trace.assessment is not None:
        _draw_poses(drawn, side, plan, trace)
        _draw_grasps(drawn, plan, grasps, trace)
        _reason_legend(drawn, trace)
    else:
        drawn.text(
            0.5, 0.5, "nothing was drawn", transform=drawn.transAxes, ha="center", fontsize=14
        )
    drawn.set_xlim(plan.low[0], plan.high[0])
    drawn.set_ylim(plan.low[1], plan.high[1])
    words.axis("off")
    text = "\n\n".join(textwrap.fill(line, 70) for line in lines)
    words.text(0.0, 1.0, text, va="top", fontsize=12, transform=words.transAxes)
    figure.suptitle(title, x=0.05, y=0.975, ha="left", fontsize=14)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def _plan(
    cloud: Cloud, request: SynthesisRequest, trace: Trace | None, found: OrientedBox | None
) -> _Plan:
    points = cloud.finite().points
    if request.gravity is not None:
        up = -np.asarray(request.gravity, dtype=np.float64)
    else:
        eye = np.zeros(3) if request.sensor is None else np.atleast_2d(request.sensor).mean(axis=0)
        up = eye - points.mean(axis=0)
        up = up / max(float(np.linalg.norm(up)), 1e-9)
    if request.region is not None:
        box = request.region.upright(up)
        rotation, centre, half = box.rotation.T, box.centre, box.size / 2
        low, high = -half - AROUND, half + AROUND
        floor: float | None = -half[2] if request.walls else None
        if found is not None:
            corners = (found.corners() - centre) @ rotation.T
            low = np.minimum(low, corners.min(axis=0) - 0.02)
            high = np.maximum(high, corners.max(axis=0) + 0.02)
    else:
        aside = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        x = aside - (aside @ up) * up
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(up, x), up])
        middle = np.median(points, axis=0) if len(points) else np.zeros(3)
        local = (points - middle) @ rotation.T
        low, high = np.percentile(local, (0.5, 99.5), axis=0) if len(local) else (
            -np.ones(3), np.ones(3)
        )  # fmt: skip
        centre, floor = middle, None
        low, high = low - 0.02, high + 0.02
    plan = _Plan(rotation, centre, low, high, floor)
    if floor is None and trace is not None and trace.observation.floor is not None:
        plane = trace.observation.floor
        floor = -float(plane.height(centre[None])[0]) / float(plane.normal @ rotation[2])
        plan = _Plan(rotation, centre, low, high, floor)
    return plan


def _heights(
    cloud: Cloud, plan: _Plan, trace: Trace | None
) -> tuple[NDArray[np.float64], float, float]:
    """Picture (rows, columns, 3) of the map, rows from low y, and the least and largest height
    over the floor (m) of its colours.
    """
    local = plan.at(cloud.finite().points)
    step = float((plan.high - plan.low)[:2].max()) / CELLS
    columns, rows = (int(np.ceil(e / step)) for e in (plan.high - plan.low)[:2])
    cell = np.floor((local[:, :2] - plan.low[:2]) / step).astype(np.int64)
    near = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
    near &= local[:, 2] < plan.high[2] + 0.4
    top = np.full((rows, columns), -np.inf)
    np.maximum.at(top, (cell[near, 1], cell[near, 0]), local[near, 2])
    top = _closed(top)
    known = np.isfinite(top)
    floor = plan.floor
    if floor is None:
        floor = float(np.percentile(top[known], 2)) if known.any() else 0.0
    height = np.where(known, top - floor, 0.0)
    high = max(float(np.percentile(height[known], 99)) if known.any() else 0.0, 0.03)
    picture = height_colours((height / high).ravel()).reshape(rows, columns, 3)
    picture[np.abs(height) < ON_FLOOR] = FLOOR
    picture[height <= -ON_FLOOR] = BELOW
    picture[~known] = OUTSIDE
    if trace is not None:
        y, x = np.mgrid[0:rows, 0:columns]
        places = np.stack(
            [plan.low[0] + (x + 0.5) * step, plan.low[1] + (y + 0.5) * step,
             np.full(x.shape, floor + LOW)], axis=-1,
        ).reshape(-1, 3)  # fmt: skip
        state = trace.observation.classify(places @ plan.rotation + plan.centre)
        unknown = (state == PointState.UNSEEN).reshape(rows, columns) & ~known
        picture[unknown] = UNKNOWN
    return picture, 0.0, high


def _closed(top: FloatArray) -> FloatArray:
    """Cells between points take the highest of their neighbours."""
    from scipy import ndimage

    known = np.isfinite(top)
    around = ndimage.maximum_filter(top, 3, mode="nearest")
    enough = ndimage.uniform_filter(known.astype(float), 3, mode="constant") * 9 > 2.5
    return np.where(~known & enough, around, top)


def _draw_region(
    axes: Any, plan: _Plan, request: SynthesisRequest, found: OrientedBox | None, *, names: bool
) -> None:
    for box, colour, style in ((request.region, "black", "-"), (found, FOUND, "--")):
        if box is None:
            continue
        box = box.upright(plan.rotation[2])
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
        corners = np.concatenate([signs, np.ones((5, 1))], axis=1) * (box.size / 2)
        at = plan.at(corners @ box.rotation.T + box.centre)
        wide = 2.5 if request.walls or colour != "black" else 1.2
        axes.plot(at[:, 0], at[:, 1], style, color=colour, linewidth=wide)
    if request.region is not None and names and request.walls:
        half = request.region.upright(plan.rotation[2]).size / 2
        for text, x, y in (("-x", -1, 0), ("+x", 1, 0), ("-y", 0, -1), ("+y", 0, 1)):
            place = x * (half[0] + 0.02), y * (half[1] + 0.02)
            axes.text(*place, text, ha="center", va="center", fontsize=11, color="black")


def _draw_side(
    axes: Any, cloud: Cloud, plan: _Plan, request: SynthesisRequest, found: OrientedBox | None
) -> None:
    local = plan.at(cloud.finite().points)
    near = (local[:, :2] > plan.low[:2]).all(axis=1) & (local[:, :2] < plan.high[:2]).all(axis=1)
    local = local[near]
    if len(local) > 30_000:
        local = local[np.random.default_rng(0).permutation(len(local))[:30_000]]
    axes.scatter(local[:, 0], local[:, 2], s=0.6, color="0.6", linewidths=0)
    if plan.floor is not None:
        axes.axhline(plan.floor, color="#4a79a8", linewidth=1.5)
        axes.text(plan.low[0], plan.floor, " floor", color="#4a79a8", va="bottom", fontsize=10)
    for box, colour, style in ((request.region, "black", "-"), (found, FOUND, "--")):
        if box is None:
            continue
        box = box.upright(plan.rotation[2])
        at = plan.at(box.centre[None])[0]
        x, z = box.size[0] / 2, box.size[2] / 2
        axes.plot(
            at[0] + np.array([-x, -x, x, x]), at[2] + np.array([z, -z, -z, z]), style,
            color=colour, linewidth=2.0,
        )  # fmt: skip
    axes.set_title("From the side, lines: where a pose comes from", loc="left", fontsize=12)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("height (m)")
    axes.set_aspect("equal")
    low, high = np.percentile(local[:, 2], (0.2, 99.8)) if len(local) else (-0.1, 0.1)
    axes.set_ylim(min(low, plan.floor if plan.floor is not None else low) - 0.03, high + 0.12)
    axes.set_xlim(plan.low[0], plan.high[0])


def _draw_poses(above: Any, side: Any, plan: _Plan, trace: Trace) -> None:
    assert trace.assessment is not None
    poses = trace.assessment.poses
    starts, ends = plan.at(trace.starts), plan.at(poses.tcp[:, :3, 3])
    back = plan.at(poses.tcp[:, :3, 3] - STEM * poses.tcp[:, :3, 2])
    colours = [reason_colour(str(reason)) for reason in trace.assessment.check.reason]
    for start, end, tail, colour in zip(starts, ends, back, colours, strict=True):
        above.plot([start[0], end[0]], [start[1], end[1]], color=colour, linewidth=0.8, alpha=0.6)
        side.plot([end[0], tail[0]], [end[2], tail[2]], color=colour, linewidth=1.2, alpha=0.8)
    above.scatter(starts[:, 0], starts[:, 1], s=14, facecolors="none", edgecolors=colours,
                  linewidths=0.9)  # fmt: skip
    above.scatter(ends[:, 0], ends[:, 1], s=26, c=colours, edgecolors="white", linewidths=0.5,
                  zorder=3)  # fmt: skip
    side.scatter(ends[:, 0], ends[:, 2], s=18, c=colours, edgecolors="white", linewidths=0.4,
                 zorder=3)  # fmt: skip


def _draw_grasps(axes: Any, plan: _Plan, grasps: Sequence[RankedGrasp], trace: Trace) -> None:
    for rank, grasp in reversed(list(enumerate(grasps, start=1))):
        pose = grasp.world_from_tcp
        width = grasp.width if np.isfinite(grasp.width) else BAR
        ends = pose[:3, 3] - trace.offset + np.outer([-0.5, 0.5], width * pose[:3, 0])
        at = plan.at(ends)
        axes.plot(at[:, 0], at[:, 1], color="black", linewidth=4.5, zorder=4)
        axes.plot(at[:, 0], at[:, 1], color=RETURNED, linewidth=2.5, zorder=5)
        if rank <= NUMBERED:
            axes.annotate(
                f"{rank}: {grasp.score:.2f}", at.mean(axis=0)[:2], xytext=(5, 5),
                textcoords="offset points", fontsize=9, zorder=6,
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            )  # fmt: skip


def _height_legend(
    axes: Any, low: float, high: float, request: SynthesisRequest, found: OrientedBox | None
) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(color=BELOW, label="below the floor"),
        Patch(color=FLOOR, label="floor"),
    ]
    handles += [
        Patch(
            color=tuple(height_colours(np.array([share]))[0]),
            label=f"{1000 * (low + share * (high - low)):.0f} mm over it",
        )
        for share in (0.15, 0.5, 1.0)
    ]
    handles.append(Patch(color=UNKNOWN, label="unknown"))
    if request.region is not None:
        name = "region, its sides are walls" if request.walls else "region, no walls"
        handles.append(Line2D([], [], color="black", linewidth=2.5, label=name))
    if found is not None:
        handles.append(
            Line2D([], [], color=FOUND, linestyle="--", linewidth=2.5, label="bin in the cloud")
        )
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=4,
                fontsize=10, frameon=False)  # fmt: skip


def _reason_legend(axes: Any, trace: Trace) -> None:
    from matplotlib.lines import Line2D

    assert trace.assessment is not None
    counts = Counter(trace.assessment.check.reason.tolist())
    handles = [
        Line2D([], [], marker="o", linestyle="", color=reason_colour(reason),
               label=f"{reason or 'returned'} {count}")
        for reason, count in counts.most_common()
    ]  # fmt: skip
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=4,
                fontsize=10, frameon=False)  # fmt: skip

"""One picture of a gripper's frames: axes, TCP, open and closed posture, what closing sweeps.

+Z, the approach, points down, as in a cell that picks from above; on the left the gripper is seen
from +Y, so that +X points right and the first finger group is on the left.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from megrasp_core.grippers import Gripper

from .closing_motion import closing_motion, pad_paths
from .frame_raster import CLOSED, CLOSED_ALPHA, OPEN, SWEPT, SWEPT_ALPHA, raster
from .gripper_picture import COLOURS
from .splat import Projection, look_along

__all__ = ["SIZE", "frame_picture"]

SIZE = (1000, 640)
DPI = 100
PALETTE = 256
HEADER, FOOTER = 86, 34
ABOVE, BELOW = 24, 50
WIDTHS = (560, 440)
SIDES = ((84, 90), (48, 48))
"""Pixels left and right of the gripper in each panel; a dimension stands left of the first."""
FRONT, OBLIQUE = (0.0, -1.0, 0.0), (-0.7, -0.62, 0.35)
LONG, SHORT = ("X closing", "Y", "Z approach"), ("X", "Y", "Z")
AXIS = 76
"""Length of the drawn axes (pixels)."""
POINTS = 1024
INK, FAINT = (0.13, 0.13, 0.16), (0.45, 0.45, 0.48)
ARROW = {"arrowstyle": "-|>", "mutation_scale": 12}
AXIS_STYLE = {**ARROW, "lw": 2.6}
HALO = [effects.withStroke(linewidth=3, foreground="white")]

Pixel = tuple[float, float]
"""Column and row of the figure."""


def frame_picture(gripper: Gripper, file: str | Path) -> Path:
    """Write a PNG of SIZE pixels with the gripper's frames and its closing motion; return its
    path. Its text field "gripper" is the gripper's hash.
    """
    motion = closing_motion(gripper)
    paths, clouds = pad_paths(gripper, motion), gripper.clouds(POINTS)
    tcp, width = gripper.tcp, gripper.description.max_width
    corners = [vertices for vertices, _ in motion.swept]
    still = [vertices for vertices, _ in motion.meshes]
    whole = np.concatenate([*corners, *still, tcp[None], np.zeros((1, 3))])
    fingers = np.concatenate([*corners, tcp[None]]) if corners else whole
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    front = _Panel(axes, _fitted(whole, FRONT, WIDTHS[0], SIDES[0]), 0)
    oblique = _Panel(axes, _fitted(fingers, OBLIQUE, WIDTHS[1], SIDES[1]), WIDTHS[0])
    for panel in (front, oblique):
        panel.image(raster(motion, clouds, panel.view))
        panel.paths(paths)
        panel.scale_bar()
    front.frame(np.zeros(3), LONG)
    front.depth(tcp, whole)
    if width is not None:
        front.opening(tcp, width, whole)
    front.tcp(tcp, named=True)
    oblique.frame(tcp, SHORT)
    oblique.tcp(tcp, named=False)
    _words(axes, gripper)
    axes.set(xlim=(0, SIZE[0]), ylim=(SIZE[1], 0), aspect="auto")
    axes.axis("off")
    return _save(figure, Path(file), gripper.hash)


class _Panel:
    """Draws into one panel; points are in the gripper frame, metres."""

    def __init__(self, axes: Axes, view: Projection, left: int) -> None:
        self.axes, self.view, self.left = axes, view, left

    def at(self, point: NDArray[np.float64]) -> Pixel:
        """Return the pixel of the figure that a point (3,) lies at."""
        column, row, _ = self.view.project(point[None])[0]
        return self.left + float(column), HEADER + float(row)

    def image(self, pixels: NDArray[np.float64]) -> None:
        """Show the raster."""
        width, height = self.view.size
        extent = (self.left, self.left + width, HEADER + height, HEADER)
        self.axes.imshow(pixels, extent=extent, interpolation="none")

    def frame(self, origin: NDArray[np.float64], labels: Sequence[str]) -> None:
        """Three axes from a point; one that points at the viewer is a dot in a circle."""
        x, y = self.at(origin)
        for index, colour in COLOURS.items():
            tip = self.at(origin + np.eye(3)[index] * AXIS / self.view.scale)
            across, down = tip[0] - x, tip[1] - y
            length = math.hypot(across, down)
            place, align = (x - 15, y - 11), "center"
            if length < 1.0:
                self.axes.plot(x, y, "o", ms=11, mfc="white", mec=colour, mew=2, zorder=6)
                self.axes.plot(x, y, "o", ms=3.5, color=colour, zorder=7)
            else:
                self._between((x, y), tip, {**AXIS_STYLE, "color": colour})
                place = tip[0] + 12 * across / length, tip[1] + 12 * down / length
            if labels is LONG and index == 0:  # above its arrow, where nothing else is
                place, align = (x + 14, y - 12), "left"
            self._text(place, labels[index], colour, ha=align, weight="bold")

    def tcp(self, tcp: NDArray[np.float64], *, named: bool) -> None:
        """The TCP: a cross hair, with its name where there is room for it."""
        x, y = self.at(tcp)
        self.axes.plot(x, y, "o", ms=9, mfc="white", mec=INK, mew=1.6, zorder=7)
        self.axes.plot(x, y, "+", ms=15, color=INK, mew=1.6, zorder=8)
        place = (x, y - 17) if named else (x + 10, y - 14)
        self._text(place, "TCP", INK, ha="center" if named else "left", weight="bold")

    def scale_bar(self) -> None:
        """A bar in the lower left corner, of a round length."""
        fitting = (n for n in (0.1, 0.05, 0.02, 0.01) if n * self.view.scale < 100)
        length = next(fitting, 0.005)
        start, y = self.left + 18, SIZE[1] - FOOTER - 12
        end = start + length * self.view.scale
        style = {"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "color": INK, "lw": 1.4}
        self._between((start, y), (end, y), style)
        self._text((end + 8, y), f"{1000 * length:.0f} mm", INK, ha="left")

    def paths(self, paths: Sequence[NDArray[np.float64]]) -> None:
        """Where the fingertips go: arrows along paths (steps, 3)."""
        for path in paths:
            points = [self.at(point) for point in path]
            if math.dist(points[0], points[-1]) < 6:
                continue
            columns, rows = zip(*points)
            style = {"color": 0.55 * SWEPT, "lw": 1.6}
            self.axes.plot(columns, rows, path_effects=HALO, zorder=4, **style)
            self._between(points[-3], points[-1], {**ARROW, **style})

    def depth(self, tcp: NDArray[np.float64], everything: NDArray[np.float64]) -> None:
        """Dimension from the origin to the TCP along Z, left of the gripper."""
        (x0, top), (x1, low) = self.at(np.zeros(3)), self.at(tcp)
        x = float(self._box(everything)[0][0]) - 30
        for start, y in ((x0, top), (x1, low)):
            self._line((start, y), (x - 5, y))
        self._dimension((x, top), (x, low))
        self._text((x - 12, (top + low) / 2), f"TCP z = {1000 * tcp[2]:.4g} mm", INK, rotation=90)

    def opening(
        self, tcp: NDArray[np.float64], width: float, everything: NDArray[np.float64]
    ) -> None:
        """Dimension of the opening below the fingertips."""
        half = np.array([width / 2, 0.0, 0.0])
        y = float(self._box(everything)[1][1]) + 22
        ends = [self.at(tcp - half), self.at(tcp + half)]
        for end in ends:
            self._line(end, (end[0], y + 5))
        self._dimension((ends[0][0], y), (ends[1][0], y))
        middle = (ends[0][0] + ends[1][0]) / 2
        self._text((middle, y + 13), f"opens {1000 * width:.4g} mm", INK, ha="center")

    def _box(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        pixels = self.view.project(points)[:, :2] + (self.left, HEADER)
        return pixels.min(axis=0), pixels.max(axis=0)

    def _line(self, start: Pixel, end: Pixel) -> None:
        self.axes.plot((start[0], end[0]), (start[1], end[1]), color=INK, lw=0.8, ls=(0, (5, 3)))

    def _dimension(self, start: Pixel, end: Pixel) -> None:
        self._between(start, end, {"arrowstyle": "<|-|>", "color": INK, "lw": 1.0})

    def _between(self, start: Pixel, end: Pixel, style: dict[str, Any]) -> None:
        ends = {"shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", end, start, arrowprops={**style, **ends}, zorder=5)

    def _text(self, at: Pixel, text: str, colour: Any, **kwargs: Any) -> None:
        options: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "fontsize": 10,
            "zorder": 9,
            **kwargs,
        }
        self.axes.text(at[0], at[1], text, color=colour, path_effects=HALO, **options)


def _fitted(
    points: NDArray[np.float64],
    direction: tuple[float, float, float],
    width: int,
    sides: tuple[int, int],
) -> Projection:
    """Return the view along a direction, Z down, whose margins are those of the points (N, 3)."""
    rotation = look_along(np.array(direction), np.array([0.0, 0.0, -1.0]))
    local = points @ rotation.T
    low, high = local.min(axis=0), local.max(axis=0)
    height = SIZE[1] - HEADER - FOOTER
    room = np.array([width - sum(sides), height - ABOVE - BELOW])
    scale = float((room / (high - low)[:2]).min())
    middle = (low + high) / 2
    middle[0] += (sides[1] - sides[0]) / 2 / scale
    middle[1] += (BELOW - ABOVE) / 2 / scale
    return Projection(rotation, middle @ rotation, scale, (width, height))


def _words(axes: Axes, gripper: Gripper) -> None:
    """Title, facts, names of the views and legend."""
    d = gripper.description
    x, y, z = (f"{1000 * value:.4g}" for value in d.tcp)
    facts = [d.kind, f"TCP ({x}, {y}, {z}) mm"]
    if d.max_width is not None:
        facts.append(f"holds {1000 * d.min_width:.4g} to {1000 * d.max_width:.4g} mm")
    facts.append(f"symmetry {d.symmetry}")
    axes.text(14, 20, d.display_name, fontsize=15, weight="bold", color=INK, va="center")
    axes.text(14, 45, f"{d.name}: " + ", ".join(facts), fontsize=10, color=FAINT, va="center")
    views = ("seen from +Y, axes: gripper frame", "fingers, obliquely, axes: TCP frame")
    for left, name in zip((0, WIDTHS[0]), views):
        axes.text(left + 14, 78, name, color=FAINT, fontsize=9, va="center")
    legend = (
        (OPEN, 1.0, "open"),
        (CLOSED, CLOSED_ALPHA, "closed"),
        (SWEPT, SWEPT_ALPHA, "swept while closing"),
    )
    at, y = 14, SIZE[1] - FOOTER / 2
    for colour, alpha, name in legend:
        pale = alpha * colour + 1.0 - alpha
        axes.add_patch(Rectangle((at, y - 7), 22, 14, fc=pale, ec=0.6 * colour, lw=1))
        axes.text(at + 28, y, name, fontsize=10, color=INK, va="center")
        at += 28 + 8 * len(name) + 26
    note = "dots: open and closed cloud; arrows: paths of the fingertips"
    axes.text(at, y, note, fontsize=10, color=INK, va="center")


def _save(figure: Figure, path: Path, text: str) -> Path:
    """Write the figure as a PNG with a palette, less than half of its size in full colour."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    with Image.open(buffer) as image:
        colours = image.convert("RGB")
    # The few pixels of the axes have no colour of their own without the rounds of k-means.
    small = colours.quantize(PALETTE, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    notes = PngInfo()
    notes.add_text("gripper", text)
    path.parent.mkdir(parents=True, exist_ok=True)
    small.save(path, optimize=True, pnginfo=notes)
    return path

"""A picture of a bin that was found: the cloud with its box, and how full each cell is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from megrasp_core.pointcloud import Cloud, FoundBin, OrientedBox

from .splat import Canvas, Projection, height_colours, look_along, segment_points

__all__ = ["draw_bin", "save_bin_picture"]

FloatArray = NDArray[np.float64]

PANEL = (520, 470)
HEADER = 50
AROUND = 0.12
"""So much is drawn around the bin (m)."""
MARGIN = np.array([0.10, 0.10, 0.06])
"""So much more than the bin is in the picture (m)."""
MAX_POINTS = 200_000
TEXT = (35, 35, 40)
RIM = np.array([0.86, 0.10, 0.16])
FLOOR = np.array([0.10, 0.35, 0.80])


def save_bin_picture(
    path: str | Path,
    cloud: Cloud,
    found: FoundBin,
    *,
    gravity: Sequence[float] | FloatArray = (0.0, 0.0, -1.0),
) -> Path:
    """Write `draw_bin` to a PNG; missing folders are made. Returns the path."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_bin(cloud, found, gravity=gravity).save(path)
    return path


def draw_bin(
    cloud: Cloud, found: FoundBin, *, gravity: Sequence[float] | FloatArray = (0.0, 0.0, -1.0)
) -> Image.Image:
    """The cloud from above with the cells of the bin, and obliquely with its box.

    Args:
        cloud: in the frame of the bin; coloured by height.
        found: rim and upright edges are drawn red, the floor blue; each cell has its fill in per
            cent, a question mark where nothing of it was seen.
        gravity: (3,) down in the same frame.
    """
    down = np.asarray(gravity, np.float64) / np.linalg.norm(gravity)
    points, colours = _scene(cloud, found.box, down)
    across = found.box.rotation[:, 1] - (found.box.rotation[:, 1] @ down) * down
    across /= np.linalg.norm(across)
    oblique = 0.74 * down + 0.60 * across + 0.30 * np.cross(down, across)
    panels = []
    for direction, up in ((down, across), (oblique, -down)):
        view = _view(found.box, look_along(direction, up))
        canvas = Canvas(view)
        canvas.draw(points, colours, _radius(points, view))
        canvas.fill()
        canvas.shade()
        _draw_box(canvas, found.box)
        panels.append(Image.fromarray(canvas.image()))
        if not len(panels) - 1:
            _write_cells(panels[0], view, found)
    x, y, z = found.box.size
    content = "empty" if found.empty else f"{100 * found.fill_level:.0f} % full"
    width, height = PANEL
    sheet = Image.new("RGB", (2 * width + 4, HEADER + height), "white")
    draw = ImageDraw.Draw(sheet)
    line = f"{1000 * x:.0f} x {1000 * y:.0f} x {1000 * z:.0f} mm inside, {content}"
    draw.text((10, 6), line, fill=TEXT, font=ImageFont.load_default(size=18))
    note = (
        f"Left: from above, fill of each cell in %. Seen: {100 * found.seen:.0f} % of the walls."
    )
    draw.text((10, 29), note, fill=(110, 110, 115), font=ImageFont.load_default(size=13))
    for index, panel in enumerate(panels):
        sheet.paste(panel, (index * (width + 4), HEADER))
    return sheet


def _scene(cloud: Cloud, box: OrientedBox, down: FloatArray) -> tuple[FloatArray, FloatArray]:
    local = np.abs(box.local(cloud.points))
    with np.errstate(invalid="ignore"):
        index = np.flatnonzero((local < box.size / 2 + [AROUND, AROUND, 0.3]).all(axis=1))
    if len(index) > MAX_POINTS:
        index = np.random.default_rng(0).permutation(index)[:MAX_POINTS]
    points = cloud.points[index]
    height = -points @ down
    low, high = np.percentile(height, [2, 99.5]) if len(height) else (0.0, 1.0)
    return points, height_colours((height - low) / max(high - low, 0.02))


def _view(box: OrientedBox, rotation: FloatArray) -> Projection:
    # The walls and what stands out of the bin belong into the picture.
    grown = OrientedBox(box.world_from_box, box.size + MARGIN)
    corners = grown.corners() @ rotation.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = float(np.min(np.array(PANEL) / (1.04 * (high - low)[:2])))
    return Projection(rotation, rotation.T @ ((low + high) / 2), scale, PANEL)


def _radius(points: FloatArray, view: Projection) -> float:
    """Half the spacing of the points on the screen, so that a surface closes."""
    screen = view.project(points)[:, :2]
    inside = ((screen >= 0) & (screen < view.size)).all(axis=1)
    blocks = len(np.unique(screen[inside].astype(int) // 8, axis=0)) * 64
    return float(np.clip(0.8 * np.sqrt(blocks / max(int(inside.sum()), 1)), 1.0, 4.0))


def _draw_box(canvas: Canvas, box: OrientedBox) -> None:
    corners = box.corners().reshape(2, 2, 2, 3)
    for first in np.ndindex(2, 2, 2):
        for axis in range(3):
            if first[axis]:
                continue
            second = tuple(1 if k == axis else first[k] for k in range(3))
            line = segment_points(corners[first], corners[second], 0.5 / canvas.view.scale)
            low = axis != 2 and first[2] == 0
            # The floor lies behind the contents, and is drawn over them thinly.
            canvas.draw(line, FLOOR if low else RIM, 0.7 if low else 1.4, lift=1.0, shaded=False)


def _write_cells(panel: Image.Image, view: Projection, found: FoundBin) -> None:
    rows, columns = found.cells.shape
    box, draw = found.box, ImageDraw.Draw(panel, "RGBA")
    lines = [([c / columns - 0.5, -0.5], [c / columns - 0.5, 0.5]) for c in range(1, columns)]
    lines += [([-0.5, r / rows - 0.5], [0.5, r / rows - 0.5]) for r in range(1, rows)]
    for ends in lines:
        draw.line(_on_screen(view, box, np.array(ends)), fill=(255, 255, 255, 150), width=1)
    apart = view.scale * min(box.size[0] / columns, box.size[1] / rows)
    font = ImageFont.load_default(size=int(np.clip(0.42 * apart, 7, 15)))
    for row in range(rows):
        for column in range(columns):
            place = np.array([[(column + 0.5) / columns - 0.5, (row + 0.5) / rows - 0.5]])
            fill = found.cells[row, column]
            text = f"{100 * fill:.0f}" if np.isfinite(fill) else "?"
            at = _on_screen(view, box, place)[0]
            draw.text(at, text, fill="white", font=font, anchor="mm", stroke_width=1,
                      stroke_fill=(20, 20, 20))  # fmt: skip


def _on_screen(
    view: Projection, box: OrientedBox, shares: FloatArray
) -> list[tuple[float, float]]:
    """Pixels of places (N, 2) of the upper face, in shares of its edges from the middle."""
    local = np.column_stack([shares, np.full(len(shares), 0.5)]) * box.size
    screen = view.project(local @ box.rotation.T + box.centre)
    return [(float(x), float(y)) for x, y in screen[:, :2]]

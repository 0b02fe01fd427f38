"""A gripper at a pose that was refused, close by, with the points that speak against it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from megrasp_core.grippers import Gripper, body_poses
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.ranking import PointState

from .grasp_picture import hides_inside, splat_radius
from .splat import Canvas, Projection, height_colours, look_along, segment_points, surface_samples

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["save_near_miss_picture"]

FloatArray = NDArray[np.float64]

PANEL = (520, 470)
HEADER = 56
REACH = 0.13
"""Half the edge of the picture (m)."""
CUT = 0.03
"""What stands so far before the TCP is left out of the level view (m)."""
MAX_POINTS = 120_000
GRIPPER = np.array([0.55, 0.63, 0.78])
MARKS = {
    PointState.INSIDE: ("in an object", (0.95, 0.45, 0.0)),
    PointState.WALL: ("in a wall", (0.86, 0.05, 0.10)),
    PointState.FLOOR: ("below the floor", (0.05, 0.25, 0.85)),
    PointState.UNSEEN: ("where nothing was seen", (0.50, 0.20, 0.72)),
}
EDGE = np.array([0.15, 0.15, 0.15])


def save_near_miss_picture(
    path: str | Path,
    cloud: Cloud,
    gripper: Gripper,
    world_from_gripper: FloatArray,
    *,
    share: float,
    points: FloatArray,
    state: NDArray[np.int8],
    up: Sequence[float] | FloatArray,
    region: OrientedBox | None = None,
    lines: tuple[str, str] = ("", ""),
) -> Path:
    """Write the gripper in the cloud, obliquely and across the closing axis; missing folders are
    made.

    Args:
        path: PNG to write.
        cloud: coloured by height.
        gripper: drawn with its fingers at `share`, half transparent.
        world_from_gripper: (4, 4).
        share: of the way from open to closed.
        points: (K, 3) marked, through everything (m).
        state: (K,) what they are marked as, see `PointState`.
        up: (3,) against gravity.
        region: whose edges are drawn; None: none.
        lines: two of the header.
    """
    up = np.asarray(up, dtype=np.float64)
    tcp = (world_from_gripper @ gripper.gripper_from_tcp)[:3, 3]
    # What matters lies between the TCP and the marks.
    centre = (
        tcp if not len(points) else 0.5 * (tcp + (points.min(axis=0) + points.max(axis=0)) / 2)
    )
    marks = np.linalg.norm(points - centre, axis=1).max(initial=0.0)
    reach = max(REACH, 1.15 * float(marks))
    samples = _samples(gripper, share, 0.9 * 2 * reach / min(PANEL))
    samples = samples @ world_from_gripper[:3, :3].T + world_from_gripper[:3, 3]
    scene, colours = _near(cloud, centre, reach, up)
    panels = []
    for level, rotation in enumerate(_views(world_from_gripper, up)):
        view = Projection(rotation, centre, 0.5 * min(PANEL) / reach, PANEL)
        canvas = Canvas(view)
        # The level view is cut open before the gripper, the other one where walls hide the inside.
        depth = (scene - tcp) @ rotation[2]
        keep = depth > (-CUT if level else -np.inf)
        if region is not None and not level:
            keep &= ~hides_inside(scene, region, view)
        canvas.draw(scene[keep], colours[keep], 1.3 * splat_radius(scene, view))
        canvas.fill()
        behind = canvas.copy()
        canvas.draw(samples, GRIPPER, 1.0)
        canvas.shade()
        behind.shade()
        canvas.colour = 0.65 * canvas.colour + 0.35 * behind.colour
        if region is not None:
            _draw_edges(canvas, region.upright(up))
        for kind, (_, colour) in MARKS.items():
            marked = points[state == kind]
            canvas.draw(marked, np.zeros(3), 4.0, lift=0.5, shaded=False)
            canvas.draw(marked, np.asarray(colour), 3.0, lift=0.6, shaded=False)
        panels.append(Image.fromarray(canvas.image()))
    return _sheet(Path(path), panels, lines, state)


def _samples(gripper: Gripper, share: float, spacing: float) -> FloatArray:
    start, end = gripper.qpos("open"), gripper.qpos("closed")
    poses = body_poses(gripper.model, start + share * (end - start))
    meshes = [mesh.mesh.moved(poses[mesh.body]) for mesh in gripper.body_meshes()]
    return surface_samples(meshes, spacing)


def _near(
    cloud: Cloud, centre: FloatArray, reach: float, up: FloatArray
) -> tuple[FloatArray, FloatArray]:
    points = cloud.finite().points
    points = points[(np.abs(points - centre) < 1.6 * reach).all(axis=1)]
    if len(points) > MAX_POINTS:
        points = points[np.random.default_rng(0).permutation(len(points))[:MAX_POINTS]]
    height = points @ up
    low, high = np.percentile(height, (1, 99.5)) if len(points) else (0.0, 1.0)
    return points, height_colours((height - low) / max(high - low, 0.02))


def _views(world_from_gripper: FloatArray, up: FloatArray) -> list[FloatArray]:
    """Obliquely from above, and level across the closing axis."""
    across = world_from_gripper[:3, 1] - (world_from_gripper[:3, 1] @ up) * up
    if np.linalg.norm(across) < 0.2:
        across = world_from_gripper[:3, 2] - (world_from_gripper[:3, 2] @ up) * up
    across /= max(float(np.linalg.norm(across)), 1e-9)
    oblique = -0.75 * up + 0.6 * across + 0.35 * np.cross(up, across)
    level = across - 0.12 * up
    return [look_along(oblique, up), look_along(level, up)]


def _draw_edges(canvas: Canvas, box: OrientedBox) -> None:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = signs * (box.size / 2) @ box.rotation.T + box.centre
    for first in range(8):
        for second in range(first):
            if np.abs(signs[first] - signs[second]).sum() == 2:
                line = segment_points(corners[first], corners[second], 0.5 / canvas.view.scale)
                canvas.draw(line, EDGE, 0.8, lift=0.4, shaded=False)


def _sheet(
    path: Path, panels: list[Image.Image], lines: tuple[str, str], state: NDArray[np.int8]
) -> Path:
    width, height = PANEL
    sheet = Image.new("RGB", (len(panels) * (width + 4) - 4, HEADER + height), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((10, 6), lines[0], fill=(35, 35, 40), font=ImageFont.load_default(size=17))
    draw.text((10, 31), lines[1], fill=(90, 90, 95), font=ImageFont.load_default(size=13))
    for index, panel in enumerate(panels):
        sheet.paste(panel, (index * (width + 4), HEADER))
    left = 10
    if any((state == kind).any() for kind in MARKS):
        draw.rectangle([0, HEADER + height - 26, width, HEADER + height], fill="white")
    for kind, (name, colour) in MARKS.items():
        if not (state == kind).any():
            continue
        fill = tuple(int(255 * c) for c in colour)
        top = HEADER + height - 22
        draw.ellipse([left, top + 2, left + 11, top + 13], fill=fill, outline=(0, 0, 0))
        font = ImageFont.load_default(size=13)
        draw.text((left + 17, top), name, fill=(20, 20, 20), font=font)
        left += 30 + int(draw.textlength(name, font=font))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
    return path

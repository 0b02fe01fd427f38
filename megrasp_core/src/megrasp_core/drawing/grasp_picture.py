"""Pictures of clouds and ranked grasps, as PNG: seen from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .splat import Canvas, Projection, height_colours, look_along, segment_points, surface_samples

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.pointcloud import Cloud, OrientedBox
    from megrasp_core.synthesizer import Synthesis

__all__ = [
    "draw_grasps",
    "draw_gripper",
    "hides_inside",
    "rank_colour",
    "save_grasp_picture",
    "splat_radius",
]

PANEL = (620, 560)
HEADER = 54
TEXT = (35, 35, 40)
GRIPPER = np.array([0.55, 0.63, 0.78])
GRIPPER_CLOSED = np.array([0.93, 0.70, 0.42])
MAX_POINTS = 150_000


class DrawnGrasp(Protocol):
    """What a picture needs of a grasp: a `RankedGrasp`, or anything with these two."""

    @property
    def world_from_gripper(self) -> np.ndarray:
        """(4, 4) pre-grasp."""
        ...

    @property
    def score(self) -> float:
        """0..1."""
        ...


def save_grasp_picture(
    path: str | Path,
    cloud: Cloud,
    grasps: Synthesis | Sequence[DrawnGrasp],
    gripper: Gripper,
    *,
    chosen: int | None = 0,
    title: str | None = None,
    count: int = 5,
    region: OrientedBox | None = None,
    gravity: Sequence[float] | np.ndarray | None = (0.0, 0.0, -1.0),
) -> Path:
    """Write `draw_grasps` to a PNG; missing folders are made. Returns the path.

    Args:
        path: of the PNG.
        cloud: in the frame of the grasps.
        grasps: a synthesis, or grasps best first.
        gripper: whose grasps they are.
        chosen: index of the grasp drawn as a gripper; None: none.
        title: first line of the header; None: as `draw_grasps` makes it.
        count: most grasps to draw.
        region: the picture is cropped to it; None: it is not.
        gravity: (3,) down in the frame of the cloud; None: the picture looks from the viewpoint.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    image = draw_grasps(
        cloud,
        grasps,
        gripper,
        chosen=chosen,
        title=title,
        count=count,
        region=region,
        gravity=gravity,
    )
    image.save(path)
    return path


def draw_grasps(
    cloud: Cloud,
    grasps: Synthesis | Sequence[DrawnGrasp],
    gripper: Gripper,
    *,
    chosen: int | None = 0,
    title: str | None = None,
    count: int = 5,
    region: OrientedBox | None = None,
    gravity: Sequence[float] | np.ndarray | None = (0.0, 0.0, -1.0),
) -> Image.Image:
    """A cloud with its best grasps, from above and obliquely.

    The chosen grasp is drawn as the open gripper, the others as forks (stem along the approach,
    fingers along Z, bar along the closing axis) from green (best) to red.

    Args:
        cloud: in the frame of the grasps; coloured by height where it has no colours.
        grasps: a synthesis, or grasps best first.
        gripper: whose grasps they are.
        chosen: index of the grasp drawn as a gripper; None: none.
        title: first line of the header; by default gripper, number of grasps and best score.
        count: most grasps to draw.
        region: the picture is cropped to it.
        gravity: (3,) down in the frame of the cloud; None: the picture looks from the viewpoint.
    """
    ranked: list[DrawnGrasp] = list(cast(Any, getattr(grasps, "grasps", grasps)))
    shown = ranked[:count]
    if chosen is not None and chosen >= len(ranked):
        chosen = None
    down = _down(cloud, gravity)
    points, colours = _scene(cloud, region, down)
    tops = [pose.world_from_gripper for pose in shown]
    views = _views(points, down, region)
    panels = []
    for view in views:
        seen = (
            np.ones(len(points), bool) if region is None else ~hides_inside(points, region, view)
        )
        canvas = Canvas(view)
        canvas.draw(points[seen], colours[seen], splat_radius(points, view))
        canvas.fill()
        behind = canvas.copy()
        if chosen is not None:
            pose = ranked[chosen].world_from_gripper
            _draw_gripper(canvas, gripper, pose, GRIPPER)
        canvas.shade()
        if view is views[0]:
            # From above the palm hides what it grasps.
            behind.shade()
            canvas.colour = 0.45 * canvas.colour + 0.55 * behind.colour
        for rank in reversed(range(len(shown))):
            _draw_fork(canvas, gripper, tops[rank], rank_colour(rank, len(shown)))
        panels.append(_labelled(canvas, gripper, tops))
    best = f", best score {shown[0].score:.2f}" if shown else ""
    line = title or f"{gripper.description.display_name}: {len(ranked)} grasps{best}"
    note = _note(len(shown), chosen)
    return _sheet(panels, line, note)


def draw_gripper(gripper: Gripper, *, size: tuple[int, int] = PANEL) -> Image.Image:
    """The gripper open and closed, from the front (X right, Z down) and from the side (Y right).

    The frame at the TCP: X red (closing), Y green, Z blue (approach), 4 cm long.
    """
    panels, names = [], []
    everything = np.concatenate([vertices for vertices, _ in gripper.meshes("open")])
    low, high = everything.min(axis=0), everything.max(axis=0)
    reach = float(np.linalg.norm(high - low))
    scale = 0.95 * min(size) / reach
    views = (("front", [0.0, -1.0, 0.0]), ("oblique", [-0.75, -0.6, 0.3]))
    for posture, colour in (("open", GRIPPER), ("closed", GRIPPER_CLOSED)):
        for name, direction in views:
            rotation = look_along(np.array(direction), np.array([0.0, 0.0, -1.0]))
            view = Projection(rotation, (low + high) / 2, scale, size)
            canvas = Canvas(view)
            meshes = gripper.meshes(posture)
            canvas.draw(surface_samples(meshes, 0.7 / scale), colour, 1.0)
            canvas.shade()
            _draw_frame(canvas, gripper.tcp)
            panels.append(Image.fromarray(canvas.image()))
            names.append(f"{posture}, {name}")
    for panel, name in zip(panels, names):
        ImageDraw.Draw(panel).text((10, 8), name, fill=TEXT, font=_font(15))
    d = gripper.description
    width = "" if d.max_width is None else f", opens to {1000 * d.max_width:.0f} mm"
    axes = "X red: closing, Y green, Z blue: approach; origin of the arrows: TCP"
    return _sheet(panels, f"{d.display_name} ({gripper.name}), {d.kind}{width}", axes, columns=2)


def rank_colour(rank: int, count: int) -> np.ndarray:
    """(3,) from green for rank 0 over yellow to red for the last of `count`."""
    x = rank / max(count - 1, 1)
    return np.array([min(1.0, 0.1 + 1.7 * x), min(0.75, 1.5 - 1.4 * x), 0.12])


def _down(cloud: Cloud, gravity: Sequence[float] | np.ndarray | None) -> np.ndarray:
    if gravity is not None:
        return np.asarray(gravity, dtype=np.float64) / np.linalg.norm(gravity)
    middle = np.nanmean(cloud.points, axis=0)
    eye = np.zeros(3) if cloud.viewpoint is None else np.atleast_2d(cloud.viewpoint).mean(axis=0)
    return (middle - eye) / max(float(np.linalg.norm(middle - eye)), 1e-9)


def _scene(
    cloud: Cloud, region: OrientedBox | None, down: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    keep = np.isfinite(cloud.points).all(axis=1)
    if region is not None:
        keep &= region.grown(0.03).contains(cloud.points)
    index = np.flatnonzero(keep)
    if len(index) > MAX_POINTS:
        index = np.random.default_rng(0).permutation(index)[:MAX_POINTS]
    points = cloud.points[index]
    if cloud.colors is not None:
        return points, cloud.colors[index]
    height = -points @ down
    low, high = np.percentile(height, [2, 99.5]) if len(height) else (0.0, 1.0)
    return points, height_colours((height - low) / max(high - low, 0.02))


def _views(points: np.ndarray, down: np.ndarray, region: OrientedBox | None) -> list[Projection]:
    """From above, and from the front left at about 40 degrees."""
    side = np.array([0.0, 1.0, 0.0]) if abs(down[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side -= (side @ down) * down
    side /= np.linalg.norm(side)
    oblique = 0.72 * down + 0.62 * side + 0.32 * np.cross(down, side)
    if region is not None:
        corners = region.corners()
    else:
        corners = np.stack([np.percentile(points, q, axis=0) for q in (0.5, 99.5)])
        x, y, z = (corners[:, i] for i in range(3))
        corners = np.array([[a, b, c] for a in x for b in y for c in z])
    views = []
    for rotation, room in ((look_along(down, side), 1.08), (look_along(oblique, -down), 1.22)):
        local = corners @ rotation.T
        extent = (local.max(axis=0) - local.min(axis=0))[:2]
        scale = float(np.min(np.array(PANEL) / (room * np.maximum(extent, 0.05))))
        centre = rotation.T @ ((local.max(axis=0) + local.min(axis=0)) / 2)
        # A gripper stands on top of the scene: leave room above in the oblique view.
        lift = 0.0 if room < 1.1 else 0.05
        views.append(Projection(rotation, centre - lift * down, scale, PANEL))
    return views


def hides_inside(points: np.ndarray, region: OrientedBox, view: Projection) -> np.ndarray:
    """Points (N,) outside the region on the viewer's side: walls that would hide the inside."""
    local = region.local(points)
    toward = -region.rotation.T @ view.rotation[2]
    beyond = np.abs(local) > region.size / 2 - 0.004
    # The face towards the viewer's up is open anyway; only faces seen from outside hide anything.
    side = int(np.argmax(np.abs(toward)))
    facing = (np.sign(local) == np.sign(toward)) & (np.abs(toward) > 0.15)
    facing[:, side] = False
    return (beyond & facing).any(axis=1)


def splat_radius(points: np.ndarray, view: Projection) -> float:
    """Half the spacing of the points on the screen, so that a surface closes."""
    screen = view.project(points)[:, :2].astype(int)
    occupied = len(np.unique(screen[:, 0] // 8 * 10_000 + screen[:, 1] // 8)) * 64
    return float(np.clip(0.8 * np.sqrt(occupied / max(len(points), 1)), 1.0, 4.0))


def _draw_gripper(canvas: Canvas, gripper: Gripper, pose: np.ndarray, colour: np.ndarray) -> None:
    samples = surface_samples(gripper.meshes("open"), 0.7 / canvas.view.scale)
    canvas.draw(samples @ pose[:3, :3].T + pose[:3, 3], colour, 1.0)


def _fork(gripper: Gripper) -> list[tuple[np.ndarray, np.ndarray]]:
    """Segments of a fork in the gripper frame: stem, bar, two prongs that end beside the TCP."""
    tcp = np.asarray(gripper.tcp)
    half = (gripper.description.max_width or 0.08) / 2
    root = tcp - np.array([0.0, 0.0, 0.045])
    x = np.array([half, 0.0, 0.0])
    return [
        (root - np.array([0.0, 0.0, 0.035]), root),
        (root - x, root + x),
        (root - x, tcp - x),
        (root + x, tcp + x),
    ]


def _draw_fork(canvas: Canvas, gripper: Gripper, pose: np.ndarray, colour: np.ndarray) -> None:
    for start, end in _fork(gripper):
        points = segment_points(start, end, 0.5 / canvas.view.scale)
        world = points @ pose[:3, :3].T + pose[:3, 3]
        # Drawn through everything within 6 cm, or a prong beside an object would not be seen.
        canvas.draw(world, colour * 0.25, 2.6, lift=0.06, shaded=False)
        canvas.draw(world, colour, 1.6, lift=0.07, shaded=False)


def _draw_frame(canvas: Canvas, origin: np.ndarray) -> None:
    for axis, colour in enumerate(([0.85, 0.1, 0.1], [0.1, 0.6, 0.1], [0.1, 0.2, 0.9])):
        end = np.asarray(origin) + 0.04 * np.eye(3)[axis]
        line = segment_points(np.asarray(origin), end, 0.5 / canvas.view.scale)
        canvas.draw(line, np.array(colour), 1.6, lift=1.0, shaded=False)


def _labelled(canvas: Canvas, gripper: Gripper, poses: Sequence[np.ndarray]) -> Image.Image:
    image = Image.fromarray(canvas.image())
    draw = ImageDraw.Draw(image)
    for rank in reversed(range(len(poses))):
        start = _fork(gripper)[0][0]
        at = canvas.view.project((poses[rank][:3, :3] @ start + poses[rank][:3, 3])[None])[0]
        colour = tuple(int(255 * c) for c in rank_colour(rank, len(poses)))
        box = [at[0] - 9, at[1] - 9, at[0] + 9, at[1] + 9]
        draw.ellipse(box, fill=colour, outline=(20, 20, 20))
        draw.text((at[0], at[1]), str(rank + 1), fill="black", font=_font(13), anchor="mm")
    return image


def _note(count: int, chosen: int | None) -> str:
    if count == 0:
        return "no grasp to show. Left: from above, right: oblique"
    gripper = "" if chosen is None else f" Number {chosen + 1} is drawn as the open gripper."
    return (
        f"The best {count}, 1 (green) to {count} (red).{gripper} Left: from above, right: oblique."
    )


def _sheet(panels: list[Image.Image], line: str, note: str, columns: int = 2) -> Image.Image:
    width, height = panels[0].size
    rows = -(-len(panels) // columns)
    size = (columns * width + (columns - 1) * 4, HEADER + rows * height + (rows - 1) * 4)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((12, 7), line, fill=TEXT, font=_font(19))
    draw.text((12, 32), note, fill=(110, 110, 115), font=_font(14))
    for i, panel in enumerate(panels):
        left, top = i % columns * (width + 4), HEADER + i // columns * (height + 4)
        sheet.paste(panel, (left, top))
    return sheet


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)

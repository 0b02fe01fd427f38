"""Pictures of a grasp library: its charts, and a contact sheet of grasps that held and that did
not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from megrasp_core.errors import MegraspError, ObjectError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.library import GraspLibrary, ObjectFacts
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectModel, ObjectSet
from megrasp_core.storage import GraspSet

from .contact_sheet import FAILURE, SUCCESS, contact_sheet
from .data_charts import draw_grippers_per_object, draw_objects, draw_yield
from .frame_raster import OPEN, reduced, solid
from .splat import Projection, look_along

__all__ = ["draw_grasp", "grasp_sheet", "library_pictures", "random_grasps"]

COLUMNS, ROWS = 6, 4
TILE, TITLE = (196, 180), 20
FRAME = 3
COLOURS = 128
"""Of the sheet's palette: it keeps the file small."""
SHOWN = 0.09
"""Points of the open gripper so near to the TCP (m) are in the picture."""
LOOKS = np.array([[0.5, 1.0, 0.4], [-0.5, -1.0, 0.4]])
"""Directions in which a grasp may be looked at, gripper frame: past the fingers, from above."""
SLANT = 8.0
"""Rise of a surface between neighbouring pixels, in pixels, from which on it is an edge."""


def library_pictures(
    library: GraspLibrary,
    stats: Mapping[str, Any],
    facts: Sequence[ObjectFacts],
    missing: Sequence[str],
    folder: Path,
    *,
    objects: ObjectSet | None = None,
    seed: int = 0,
) -> tuple[list[Path], list[str]]:
    """Draw yield.png, grippers_per_object.png, objects.png and grasps.png into a folder.

    Args:
        library: the grasps.
        stats: its `library_stats`.
        facts: of the objects that could be loaded.
        missing: names of those that could not.
        folder: made when missing.
        objects: keeps the models that are loaded.
        seed: of the grasps that are drawn.

    Returns:
        The pictures, and notes on what is not in them.
    """
    pictures = [
        draw_yield(stats, folder / "yield.png"),
        draw_grippers_per_object(stats, folder / "grippers_per_object.png"),
        draw_objects(facts, missing, folder / "objects.png"),
    ]
    notes = []
    if missing:
        notes.append(
            f"{len(missing)} objects could not be loaded and are in no picture of objects or "
            f"grasps: {', '.join(missing[:3])}{', ...' if len(missing) > 3 else ''}"
        )
    sheet, left_out = grasp_sheet(library, folder / "grasps.png", objects=objects, seed=seed)
    return [*pictures, *([sheet] if sheet else [])], [*notes, *left_out]


def grasp_sheet(
    library: GraspLibrary, path: Path, *, objects: ObjectSet | None = None, seed: int = 0
) -> tuple[Path | None, list[str]]:
    """Draw random successes (green) in the upper half and failures (red, with the reason) in the
    lower half.

    Returns:
        The sheet, None where no grasp can be drawn, and notes on grippers that cannot be loaded.
    """
    objects = objects or ObjectSet(())
    grippers, notes = _loaded(library.grippers)
    rng = np.random.default_rng(seed)
    half = COLUMNS * ROWS // 2
    with TemporaryDirectory() as scratch:
        tiles: list[tuple[Path, str, bool | None]] = []
        for success in (True, False):
            for entry, index in random_grasps(library, grippers, objects, success, half, rng):
                gripper, model = grippers[entry.gripper], objects[entry.object_name]
                pose = matrix_from_pose7(entry.object_from_tcp[index])
                image = draw_grasp(gripper, model, pose)
                file = Path(scratch) / f"{len(tiles)}.png"
                _framed(image, entry.object_name, SUCCESS if success else FAILURE).save(file)
                reason = f": {entry.reason[index].replace('_', ' ')}" if not success else ""
                tiles.append((file, entry.gripper + reason, success))
        if not tiles:
            return None, [*notes, "no grasp could be drawn"]
        contact_sheet(tiles, path, columns=COLUMNS, tile_width=TILE[0])
    with Image.open(path) as image:
        small = image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    return path, notes


def random_grasps(
    library: GraspLibrary,
    grippers: Mapping[str, Gripper],
    objects: ObjectSet,
    success: bool,
    count: int,
    rng: np.random.Generator,
) -> list[tuple[GraspSet, int]]:
    """At most `count` grasps (set, index) of one outcome: grippers take turns, and an object comes
    again only where a gripper has no other.
    """
    left = {
        name: [e for e in library if e.gripper == name and (e.success == success).any()]
        for name in grippers
    }
    found: list[tuple[GraspSet, int]] = []
    used: set[str] = set()
    while len(found) < count and any(left.values()):
        for name in rng.permutation([name for name, sets in left.items() if sets]):
            sets = left[name]
            fresh = [entry for entry in sets if entry.object_name not in used] or sets
            entry = fresh[int(rng.integers(len(fresh)))]
            sets.remove(entry)
            try:
                _ = objects[entry.object_name]
            except ObjectError:
                continue
            used.add(entry.object_name)
            found.append((entry, int(rng.choice(np.flatnonzero(entry.success == success)))))
    return found[:count]


def draw_grasp(
    gripper: Gripper, model: ObjectModel, object_from_tcp: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the picture (H, W, 3), 0..1, of the open gripper at a pose (4, 4) on an object, the
    gripper's approach downwards, from the side that shows more of the object.
    """
    gripper_from_object = gripper.gripper_from_tcp @ np.linalg.inv(object_from_tcp)
    mesh = model.mesh.moved(gripper_from_object)
    cloud = gripper.clouds().open_points
    near = cloud[np.linalg.norm(cloud - gripper.tcp, axis=1) < SHOWN]
    meshes = gripper.meshes("open")
    # Dark objects would hide their own shading.
    paint = 0.35 + 0.65 * np.asarray(model.colour)
    best, most = np.zeros(0), -1
    for look in LOOKS:
        view = _view(look, np.concatenate([mesh.vertices, near]))
        step = SLANT / view.scale
        image, hand = solid(meshes, view, OPEN, step)
        colour, thing = solid([mesh], view, paint, step)
        image[~np.isfinite(hand)] = 1.0
        front = np.isfinite(thing) & (thing <= hand)
        image[front] = colour[front]
        if front.sum() > most:
            best, most = image, int(front.sum())
    return reduced(best)


def _view(look: NDArray[np.float64], points: NDArray[np.float64]) -> Projection:
    """The view along a direction (3,), the approach downwards, that shows the points (N, 3)."""
    rotation = look_along(look, np.array([0.0, 0.0, -1.0]))
    seen = points @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = float(0.94 * (np.array(TILE) / (high - low)[:2]).min())
    return Projection(rotation, rotation.T @ (low + high) / 2, scale, TILE)


def _framed(image: NDArray[np.float64], title: str, colour: tuple[int, int, int]) -> Image.Image:
    width, height = TILE[0], TILE[1] + TITLE
    picture = Image.new("RGB", (width, height), "white")
    picture.paste(Image.fromarray((255.0 * image + 0.5).astype(np.uint8)), (0, TITLE))
    draw = ImageDraw.Draw(picture)
    short = title.split("/", 3)[-1] if title.startswith("asset/") else title
    draw.text((FRAME + 4, FRAME + 2), short, fill=(60, 60, 60), font=ImageFont.load_default(12))
    draw.rectangle((0, 0, width - 1, height - 1), outline=colour, width=FRAME)
    return picture


def _loaded(names: Sequence[str]) -> tuple[dict[str, Gripper], list[str]]:
    grippers, notes = {}, []
    for name in names:
        try:
            grippers[name] = load_gripper(name)
        except MegraspError as error:
            notes.append(
                f"gripper {name} cannot be loaded and is in no picture of grasps: {error}"
            )
    return grippers, notes

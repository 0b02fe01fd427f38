"""Pictures of objects: the surface that cameras see beside the convex pieces that touch."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from megrasp_core.meshes import Mesh
from megrasp_core.objects import ObjectModel

from .contact_sheet import contact_sheet
from .frame_raster import reduced, solid
from .splat import Projection, look_along

__all__ = ["MOST_ON_SHEET", "draw_object", "object_sheet"]

HALF = (170, 170)
"""Pixels of either half of a tile."""
TITLE, LONGEST = 22, 40
"""Pixels above a tile, and characters of the name there."""
COLUMNS = 4
MOST_ON_SHEET = 200
LOOK = np.array([0.55, 0.8, -0.55])
SLANT = 8.0
"""Rise of a surface between neighbouring pixels, in pixels, from which on it is an edge."""
GOLDEN = 0.61803
"""Share of the colour wheel between neighbouring pieces."""


def draw_object(model: ObjectModel) -> NDArray[np.float64]:
    """Return the picture (H, 2 H, 3), 0..1: the visual surface in the object's colour, and each
    convex piece in a colour of its own, from above at a slant.
    """
    points = np.concatenate([model.vertices, *(piece.vertices for piece in model.pieces)])
    view = _view(points)
    # Dark objects would hide their own shading.
    surface = _picture([model.mesh], [0.35 + 0.65 * np.asarray(model.colour)], view)
    paints = [
        np.array(colorsys.hsv_to_rgb((index * GOLDEN) % 1.0, 0.45, 0.95))
        for index in range(len(model.pieces))
    ]
    pieces = [Mesh(vertices, faces) for vertices, faces in model.pieces]
    return np.concatenate([surface, _picture(pieces, paints, view)], axis=1)


def _picture(
    meshes: Sequence[Mesh], paints: Sequence[NDArray[np.float64]], view: Projection
) -> NDArray[np.float64]:
    """Each mesh in its paint (3,), the nearest on top, on white: (H, W, 3)."""
    image, nearest = np.ones((1, 1, 3)), np.full((1, 1), np.inf)
    for mesh, paint in zip(meshes, paints, strict=True):
        colour, depth = solid([mesh], view, paint, SLANT / view.scale)
        front = depth < nearest
        image = np.where(front[..., None], colour, image)
        nearest = np.where(front, depth, nearest)
    return reduced(image)


def object_sheet(models: Sequence[ObjectModel], path: Path) -> Path:
    """Write the contact sheet (PNG) of at most MOST_ON_SHEET objects and return its path.

    Below each its name, size, mass and number of pieces. Raises ValueError without an object.
    """
    with TemporaryDirectory() as scratch:
        tiles: list[tuple[Path, str, bool | None]] = []
        for model in models[:MOST_ON_SHEET]:
            file = Path(scratch) / f"{len(tiles)}.png"
            _titled(draw_object(model), model.name).save(file)
            size = " x ".join(f"{1000 * edge:.0f}" for edge in model.extents)
            pieces = f"{len(model.pieces)} piece{'' if len(model.pieces) == 1 else 's'}"
            tiles.append((file, f"{size} mm, {model.mass:.2g} kg, {pieces}", None))
        return contact_sheet(tiles, path, columns=COLUMNS, tile_width=2 * HALF[0])


def _titled(image: NDArray[np.float64], title: str) -> Image.Image:
    height, width = image.shape[:2]
    picture = Image.new("RGB", (width, height + TITLE), "white")
    picture.paste(Image.fromarray((255.0 * image + 0.5).astype(np.uint8)), (0, TITLE))
    font = ImageFont.load_default(15)
    ImageDraw.Draw(picture).text((4, 2), title[:LONGEST], fill=(20, 20, 20), font=font)
    return picture


def _view(points: NDArray[np.float64]) -> Projection:
    """The view that shows the points (N, 3)."""
    rotation = look_along(LOOK, np.array([0.0, 0.0, 1.0]))
    seen = points @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = float(0.92 * (np.array(HALF) / (high - low)[:2]).min())
    return Projection(rotation, rotation.T @ (low + high) / 2, scale, HALF)

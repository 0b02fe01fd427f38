"""One picture of many: the pictures of all picks of a run with their outcome below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

CAPTION_HEIGHT = 26
GAP = 6
SUCCESS, FAILURE, NEUTRAL = (20, 120, 40), (170, 30, 30), (40, 40, 40)


def contact_sheet(
    tiles: Sequence[tuple[Path, str, bool | None]],
    path: Path,
    *,
    columns: int = 4,
    tile_width: int = 420,
) -> Path:
    """Writes the sheet to `path` (PNG) and returns it.

    tiles: (picture, caption, success), in reading order; success None means neither success nor
    failure. Pictures are scaled to `tile_width` pixels. Raises ValueError without a tile.
    """
    if not tiles:
        raise ValueError("no pictures were given; expected at least one for a contact sheet")
    columns = min(columns, len(tiles))
    images = []
    for picture, _, _ in tiles:
        with Image.open(picture) as image:
            height = round(image.height * tile_width / image.width)
            images.append(image.convert("RGB").resize((tile_width, height)))
    tile_height = max(image.height for image in images)
    rows = -(-len(tiles) // columns)
    cell = (tile_width + GAP, tile_height + CAPTION_HEIGHT + GAP)
    sheet = Image.new("RGB", (columns * cell[0] + GAP, rows * cell[1] + GAP), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=15)
    for index, (image, (_, caption, success)) in enumerate(zip(images, tiles)):
        left = GAP + (index % columns) * cell[0]
        top = GAP + (index // columns) * cell[1]
        sheet.paste(image, (left, top))
        colour = NEUTRAL if success is None else SUCCESS if success else FAILURE
        draw.text((left + 4, top + tile_height + 4), caption, fill=colour, font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
    return path

"""What docs/frames.md says of every gripper: a table and the pictures, from the descriptions."""

from __future__ import annotations

from collections.abc import Iterable

from megrasp_core.grippers import (
    GripperDescription,
    cad_folders,
    gripper_folders,
    load_description,
)

__all__ = ["frames_block", "own_descriptions"]

HEADER = """| gripper | kind | TCP (mm) | holds (mm) | symmetry | fingers on -X | opposite |
|---|---|---|---|---|---|---|
"""


def own_descriptions() -> list[GripperDescription]:
    """Return the descriptions of all registered grippers but the CAD models, sorted by name."""
    cad = cad_folders()
    return [
        load_description(folder) for name, folder in gripper_folders().items() if name not in cad
    ]


def frames_block(descriptions: Iterable[GripperDescription], images: str) -> str:
    """Return the table and the pictures of grippers in markdown; `images` is the pictures' folder
    as the page links to it.
    """
    rows, pictures = [], []
    for d in descriptions:
        width = "-"
        if d.max_width is not None:
            width = f"{_millimetres(d.min_width)} to {_millimetres(d.max_width)}"
        cells = [
            f"[{d.name}]({images}/{d.name}.png)",
            d.kind,
            ", ".join(_millimetres(value) for value in d.tcp),
            width,
            str(d.symmetry),
            ", ".join(d.fingers[0]),
            "; ".join(", ".join(group) for group in d.fingers[1:]),
        ]
        rows.append(f"| {' | '.join(cells)} |\n")
        pictures.append(f"\n![Frames of the {d.display_name}]({images}/{d.name}.png)\n")
    return HEADER + "".join(rows) + "".join(pictures)


def _millimetres(value: float) -> str:
    return f"{1000 * value:.4g}"

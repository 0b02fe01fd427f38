"""One picture of all picks of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from megrasp_core.drawing.contact_sheet import contact_sheet

from .clearing import PickRecord


def sheet_of_picks(records: Sequence[PickRecord], path: Path) -> Path | None:
    """The contact sheet of all picks that have a picture; None if there are none."""
    tiles = [
        (
            Path(record.picture),
            f"{record.attempt} {record.gripper}: "
            + (", ".join(record.removed) if record.success else f"failed, {record.reason}"),
            record.success,
        )
        for record in records
        if record.picture is not None
    ]
    return contact_sheet(tiles, path) if tiles else None

"""A picture of one round: what was seen and planned, and the closed hand, attempt by attempt."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from megrasp_core.drawing.contact_sheet import contact_sheet
from megrasp_core.drawing.grasp_picture import save_grasp_picture
from megrasp_core.grippers import Gripper
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import Synthesis

from .protocol import Tried
from .world import WORKSPACE


class RoundPicture:
    """Collects the attempts of a round; `save` writes the sheet."""

    def __init__(self, gripper: Gripper) -> None:
        self._gripper = gripper
        self._folder = tempfile.TemporaryDirectory(prefix="megrasp_round_")
        self._tiles: list[tuple[Path, str, bool | None]] = []

    def add(
        self,
        cloud: Cloud,
        answer: Synthesis,
        tried: Tried,
        hand: NDArray[np.uint8] | None,
    ) -> None:
        """Take in one attempt, as `OnAttempt` has it."""
        number = len(self._tiles) + 1
        outcome = tried.attempt.outcome.value.replace("_", " ")
        caption = f"{number}: score {tried.grasp.score:.2f}, {outcome} {' '.join(tried.removed)}"
        seen = save_grasp_picture(
            Path(self._folder.name) / f"seen_{number}.png",
            cloud,
            answer,
            self._gripper,
            title=f"attempt {number}: {len(answer.grasps)} grasps",
            region=WORKSPACE,
        )
        if hand is not None:
            _beside(seen, hand)
        self._tiles.append((seen, caption, tried.attempt.success))

    def save(self, path: Path) -> Path | None:
        """Write the sheet (PNG); None where the round had no attempt."""
        if not self._tiles:
            return None
        return contact_sheet(self._tiles, path, columns=2, tile_width=900)


def _beside(path: Path, hand: NDArray[np.uint8]) -> None:
    """Put the picture of a hand (h, w, 3) to the right of a picture file."""
    with Image.open(path) as left:
        seen = left.convert("RGB")
    right = Image.fromarray(hand)
    right = right.resize((round(right.width * seen.height / right.height), seen.height))
    both = Image.new("RGB", (seen.width + right.width, seen.height))
    both.paste(seen, (0, 0))
    both.paste(right, (seen.width, 0))
    both.save(path)

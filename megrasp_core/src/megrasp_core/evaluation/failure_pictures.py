"""Pictures of the executed grasps that failed, by their cause: why, is seen sooner than read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from megrasp_core.cell.pick_cycle import PickCycle
from megrasp_core.drawing.contact_sheet import contact_sheet
from megrasp_core.drawing.grasp_picture import save_grasp_picture
from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.simulation import ring_cameras
from megrasp_core.synthesizer import RankedGrasp

__all__ = ["FailurePictures"]

VIEWS = ring_cameras(10, elevation=(0.7, 1.3))
"""Cameras of the pictures; they see more than the one that was planned with, and without noise."""
AROUND = 0.15
"""So far (m) from the TCP the scene is shown."""
MISSED = 1e-3
"""With a smaller share of the scene around it all is shown: it was aimed at nothing."""


@dataclass(frozen=True)
class FailurePictures:
    """A folder with a folder for every cause: `slipped/007_03.png` is attempt 3 in scene 7. Each
    shows the gripper at the pre-grasp, in the scene as it was, from above and from the side.

    Attributes:
        folder: of the pictures.
        gripper: that is shown.
    """

    folder: Path
    gripper: Gripper

    def take(
        self,
        cycle: PickCycle,
        grasp: RankedGrasp,
        *,
        scene: int,
        attempt: int,
        reason: str,
        target: str,
    ) -> Path:
        """Write the picture of a grasp in the scene that the cycle is at.

        Args:
            cycle: as before the attempt.
            grasp: that failed.
            scene: number of the scene.
            attempt: number in it, from 1.
            reason: of the verdict.
            target: name of the object that was aimed at.
        """
        cloud = cycle.look(VIEWS, None, np.random.default_rng(0))
        near = np.linalg.norm(cloud.points - grasp.world_from_tcp[:3, 3], axis=1) < AROUND
        if near.mean() < MISSED:
            near[:] = True
        clear = f"{1000 * grasp.clearance:.0f} mm clear"
        return save_grasp_picture(
            self.folder / reason / f"{scene:03d}_{attempt:02d}.png",
            cloud.select(near),
            [grasp],
            self.gripper,
            title=f"{reason}: {target.rpartition('/')[2]}, score {grasp.score:.2f}, {clear}",
        )

    def require_new(self) -> None:
        """Pictures of another run would be among those of this one.

        Raises:
            InvalidRequestError: there are some.
        """
        if any(self.folder.glob("*/*.png")):
            raise InvalidRequestError(
                f"{self.folder} holds pictures of another run; expected a folder without. Give "
                "another one, or delete it."
            )

    def sheets(self) -> list[Path]:
        """Write `CAUSE.png`, all pictures of a cause in one, and return those."""
        return [
            contact_sheet(
                [
                    (
                        picture,
                        "scene {}, attempt {}".format(*map(int, picture.stem.split("_"))),
                        None,
                    )
                    for picture in sorted(cause.glob("*.png"))
                ],
                self.folder / f"{cause.name}.png",
                columns=3,
                tile_width=560,
            )
            for cause in sorted(self.folder.glob("*/"))
            if any(cause.glob("*.png"))
        ]

"""Pictures of a clearing run: cloud and ranked grasps before every pick, a contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from megrasp_msgs.msg import GraspArray
from sensor_msgs.msg import PointCloud2

from megrasp_core.cell.clearing import PickRecord
from megrasp_core.cell.pick_sheet import sheet_of_picks
from megrasp_core.drawing.grasp_picture import save_grasp_picture
from megrasp_core.errors import CloudError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_ros.conversions import matrix_from_pose, points_from_cloud


@dataclass(frozen=True)
class _Drawn:
    """What a picture needs of a grasp."""

    world_from_gripper: np.ndarray
    score: float


class ClearingPictures:
    """Draws into one folder: pick_01.png, pick_02.png .., contact_sheet.png."""

    def __init__(self, folder: Path, region: OrientedBox | None) -> None:
        self._folder = folder
        self._region = region
        self._grippers: dict[str, Gripper] = {}
        # Pictures of an earlier, longer run would pass for this one's.
        for old in (*folder.glob("pick_*.png"), folder / "contact_sheet.png"):
            old.unlink(missing_ok=True)

    def pick(
        self, attempt: int, cloud: PointCloud2, grasps: GraspArray, chosen: int | None, name: str
    ) -> str | None:
        """Path of the picture of one pick with gripper `name`.

        None if there is nothing to draw: no finite point, or grasps in another frame than the
        cloud.
        """
        if grasps.grasps and grasps.header.frame_id != cloud.header.frame_id:
            return None
        try:
            points = points_from_cloud(cloud)
        except CloudError:
            return None
        if name not in self._grippers:
            self._grippers[name] = load_gripper(name)
        drawn = [
            _Drawn(matrix_from_pose(grasp.pregrasp, "grasp.pregrasp"), float(grasp.score))
            for grasp in grasps.grasps
        ]
        path = self._folder / f"pick_{attempt:02d}.png"
        save_grasp_picture(
            path,
            Cloud(points),
            drawn,
            self._grippers[name],
            chosen=chosen,
            title=f"pick {attempt}: {name}, {len(drawn)} grasps",
            region=self._region,
        )
        return str(path)

    def contact_sheet(self, records: Sequence[PickRecord]) -> str | None:
        """Path of the sheet, None without a picture."""
        path = sheet_of_picks(records, self._folder / "contact_sheet.png")
        return None if path is None else str(path)

"""Attempts of a cell, written where `megrasp calibrate` and `megrasp train` find them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from megrasp_msgs.msg import Grasp, GraspArray, OrientedBox
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import DataError, MegraspError
from megrasp_core.pointcloud import Plane, level_floor
from megrasp_core.storage import Attempt, AttemptFolder

from .calling import GraspServerError
from .conversions import box_from_message, matrix_from_pose, points_from_cloud
from .server.frames import FrameSource, gravity_in
from .server.parameter_table import TABLE
from .server.parameters import Settings, settings_of

if TYPE_CHECKING:
    from .client import GraspClient


class AttemptRecorder:
    """Writes attempts with all that a synthesis knew: cloud, region and the server's settings."""

    def __init__(
        self, client: GraspClient, node: Node, folder: AttemptFolder | str | Path
    ) -> None:
        self._client, self._node = client, node
        self._folder = folder if isinstance(folder, AttemptFolder) else AttemptFolder(folder)
        self._frames = FrameSource(node)
        self._asked: tuple[PointCloud2, OrientedBox | None] | None = None

    def asked(self, cloud: PointCloud2, region: OrientedBox | None) -> None:
        """Remember what the next answer will be about."""
        self._asked = cloud, region

    def keep(
        self,
        grasps: GraspArray,
        grasp: Grasp,
        *,
        success: bool,
        reason: str,
        extra: dict[str, Any],
    ) -> Path | None:
        """Write one attempt; None, with a warning in the log, where it cannot be."""
        try:
            attempt = self._attempt(grasps, grasp, success, reason, extra)
            return self._folder.add(attempt)
        except (MegraspError, GraspServerError, OSError) as error:
            self._node.get_logger().warning(f"the attempt was not recorded: {error}")
            return None

    def _attempt(
        self, grasps: GraspArray, grasp: Grasp, success: bool, reason: str, extra: dict[str, Any]
    ) -> Attempt:
        if self._asked is None or self._asked[0].header.stamp != grasps.header.stamp:
            raise DataError(
                "the grasps are not those of the last cloud that this client asked for; expected "
                "its last answer. Record an attempt before the next synthesis."
            )
        cloud, region = self._asked
        settings = server_settings(self._client)
        self._frames.listen(settings)
        frame, planning_from_cloud = self._frames.planning_from_cloud(cloud.header, settings)
        if frame != grasps.header.frame_id:
            raise DataError(
                f"the grasps are in {grasps.header.frame_id!r} and the server's frame is "
                f"{frame!r} by now; expected the same. Its parameters were changed meanwhile."
            )
        gravity = gravity_in(frame, settings)
        rotation, place = planning_from_cloud[:3, :3], planning_from_cloud[:3, 3]
        asked = None if region is None else box_from_message(region)
        return Attempt(
            time=time.time_ns(),
            points=points_from_cloud(cloud) @ rotation.T + place,
            frame=frame,
            sensor=rotation @ settings.sensor_origin + place,
            gravity=gravity,
            region=settings.region if asked is None else asked,
            walls=settings.region_walls,
            floor=_floor(settings, gravity),
            assume_empty=settings.assume_empty,
            gripper=grasps.gripper,
            gripper_hash=self._hash(grasps.gripper),
            world_from_tcp=matrix_from_pose(grasp.tcp, "tcp"),
            world_from_gripper=matrix_from_pose(grasp.pregrasp, "pregrasp"),
            approach=matrix_from_pose(grasp.approach, "approach"),
            retreat=matrix_from_pose(grasp.retreat, "retreat"),
            opening=float(grasp.opening),
            width=float(grasp.width),
            score=float(np.clip(grasp.score, 0.0, 1.0)),
            rank=int(grasp.id),
            model=grasps.model_id,
            seed=int(grasps.seed),
            success=bool(success),
            reason=reason,
            source=self._node.get_fully_qualified_name(),
            extra=extra,
        )

    def _hash(self, gripper: str) -> str:
        active = self._client.active_gripper
        if active is not None and active.name == gripper:
            return active.description_hash
        found = self._client.grippers().get(gripper)
        if found is None:
            raise DataError(
                f"the server no longer knows gripper {gripper!r}; expected its description."
            )
        return found.description_hash


def server_settings(client: GraspClient) -> Settings:
    """The parameters of the server as it reads them itself.

    Raises:
        DataError: it is of another version.
    """
    values = client.parameters(TABLE)
    missing = sorted(set(TABLE) - set(values))
    if missing:
        raise DataError(
            f"the server has no parameters {', '.join(missing)}; expected a grasp_server of this "
            "version. Install the same one for both."
        )
    return settings_of(values)


def _floor(settings: Settings, gravity: np.ndarray) -> Plane | None:
    floor = settings.floor
    return floor if floor is None or isinstance(floor, Plane) else level_floor(floor, gravity)

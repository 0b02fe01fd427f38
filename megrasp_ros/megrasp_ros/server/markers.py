"""Pictures of grasps for RViz: one line drawing of a two-finger fork for each grasp."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import Point
from megrasp_msgs.msg import GraspArray
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from megrasp_ros.conversions import matrix_from_pose

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

MAX_DRAWN = 50
_FINGER = 0.04
_STEM = 0.05
_DEFAULT_WIDTH = 0.08


def grasp_markers(grasps: GraspArray, gripper: Gripper | None) -> MarkerArray:
    """Return markers that replace the earlier ones; green is the best score, red the worst.
    Thickest is rank 0.
    """
    drawn = [Marker(header=grasps.header, ns="grasps", action=Marker.DELETEALL)]
    if gripper is None or not grasps.grasps:
        return MarkerArray(markers=drawn)
    fork = _fork(gripper.description.max_width or _DEFAULT_WIDTH)
    for rank, grasp in enumerate(grasps.grasps[:MAX_DRAWN]):
        world_from_tcp = matrix_from_pose(grasp.tcp, "tcp")
        points = fork @ world_from_tcp[:3, :3].T + world_from_tcp[:3, 3]
        marker = Marker(
            header=grasps.header, ns="grasps", id=rank, type=Marker.LINE_LIST, action=Marker.ADD
        )
        marker.pose.orientation.w = 1.0
        marker.scale.x = 0.004 if rank == 0 else 0.0015
        score = float(np.clip(grasp.score, 0.0, 1.0))
        marker.color = ColorRGBA(r=1.0 - score, g=score, b=0.1, a=1.0 if rank == 0 else 0.6)
        marker.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in points]
        drawn.append(marker)
    return MarkerArray(markers=drawn)


def _fork(width: float) -> NDArray[np.float64]:
    """Return the line ends (2 * lines, 3) of a fork in TCP coordinates."""
    half = width / 2
    corners = {
        "stem": (0.0, 0.0, -_FINGER - _STEM), "palm": (0.0, 0.0, -_FINGER),
        "left": (-half, 0.0, -_FINGER), "right": (half, 0.0, -_FINGER),
        "left tip": (-half, 0.0, 0.0), "right tip": (half, 0.0, 0.0),
    }  # fmt: skip
    lines = ("stem", "palm", "left", "right", "left", "left tip", "right", "right tip")
    return np.array([corners[name] for name in lines])

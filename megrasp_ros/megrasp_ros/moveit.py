"""Grasps for MoveIt 2: as moveit_msgs/Grasp, and one after another to a planner.

moveit_msgs is imported when it is needed: without MoveIt the rest of the package works as ever.

For example, with a client (client.py) and a function `plan` that asks MoveIt for a trajectory to
the approach pose and on, and returns None where there is none::

    grasps = client.synthesize(num_grasps=20).grasps
    found = first_that_plans(to_moveit_grasps(grasps), plan)
    if found is not None:
        grasp, trajectory = found
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, Vector3
from megrasp_msgs.msg import Grasp, GraspArray
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from megrasp_core.errors import InvalidRequestError

from .conversions import matrix_from_pose, pose_from_matrix

Solution = TypeVar("Solution")

SHORTEST = 0.5
"""Share of an approach or retreat that a planner must at least manage."""


def to_moveit_grasps(
    grasps: GraspArray,
    *,
    gripper_from_link: ArrayLike | None = None,
    link: str = "",
    max_effort: float = 0.0,
    allowed_touch_objects: Iterable[str] = (),
) -> list[Any]:
    """Return moveit_msgs/Grasp messages in the order of the ranking.

    MoveIt's grasp_pose is our pre-grasp: the pose of the open gripper from which closing makes the
    grasp. pre_grasp_approach leads there from the approach pose, post_grasp_retreat on to the
    retreat pose; both are straight, so that direction and distance say them.

    Args:
        grasps: an answer, or a message of the topic `grasps`.
        gripper_from_link: (4, 4) pose in the gripper frame of the link that MoveIt moves (the
            parent link of the end effector, often the flange); None: it is the gripper frame.
        link: name of that link, the frame of the approach's direction. Empty: directions are in
            the frame of the grasps.
        max_effort: of every joint in the grasp posture (N or N m); 0: not said.
        allowed_touch_objects: names in the planning scene that may be touched.

    Raises:
        ImportError: moveit_msgs is not installed, with what to install.
        InvalidRequestError: no rigid matrix, a pose of the grasps is none.
    """
    offset = np.eye(4) if gripper_from_link is None else np.asarray(gripper_from_link, np.float64)
    if offset.shape != (4, 4) or not np.allclose(offset[:3, :3] @ offset[:3, :3].T, np.eye(3)):
        raise InvalidRequestError(
            f"gripper_from_link has shape {offset.shape} or is not rigid; expected a (4, 4) pose "
            "of the link in the gripper frame."
        )
    if grasps.grasps:
        _require_moveit()
    touched = list(allowed_touch_objects)
    return [
        _moveit_grasp(grasps.header, grasps.gripper, grasp, offset, link, max_effort, touched)
        for grasp in grasps.grasps
    ]


def _require_moveit() -> None:
    try:
        import moveit_msgs.msg  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "moveit_msgs is not installed; expected the messages of MoveIt 2, for the grasps "
            "as MoveIt has them. Run `sudo apt install ros-jazzy-moveit-msgs` and source ROS "
            "again; first_that_plans takes the grasps of an answer as they are, without it."
        ) from error


def first_that_plans(
    grasps: Iterable[Any], plan: Callable[[Any], Solution | None]
) -> tuple[Any, Solution] | None:
    """Return the best grasp that can be reached, and how; None where none can.

    Args:
        grasps: best first; of MoveIt's kind or ours.
        plan: returns None where it finds no way.
    """
    for grasp in grasps:
        solution = plan(grasp)
        if solution is not None:
            return grasp, solution
    return None


def _moveit_grasp(
    header: Header,
    gripper: str,
    grasp: Grasp,
    gripper_from_link: NDArray[np.float64],
    link: str,
    max_effort: float,
    touched: list[str],
) -> Any:
    from moveit_msgs.msg import Grasp as MoveItGrasp  # type: ignore[import-not-found]

    base = matrix_from_pose(grasp.pregrasp, "pregrasp")
    approach = matrix_from_pose(grasp.approach, "approach")
    retreat = matrix_from_pose(grasp.retreat, "retreat")
    # In the link's own axes the approach stays right wherever the planner moves the grasp to.
    turn = (base @ gripper_from_link)[:3, :3] if link else np.eye(3)
    there = Header(stamp=header.stamp, frame_id=link or header.frame_id)
    return MoveItGrasp(
        id=f"{gripper}_{grasp.id}",
        pre_grasp_posture=_trajectory(header, grasp.pregrasp_posture, 0.0),
        grasp_posture=_trajectory(header, grasp.grasp_posture, max_effort),
        grasp_pose=PoseStamped(header=header, pose=pose_from_matrix(base @ gripper_from_link)),
        grasp_quality=float(grasp.score),
        pre_grasp_approach=_translation(there, turn, base[:3, 3] - approach[:3, 3]),
        # Up is up: not in the link's axes.
        post_grasp_retreat=_translation(header, np.eye(3), retreat[:3, 3] - base[:3, 3]),
        post_place_retreat=_translation(there, turn, approach[:3, 3] - base[:3, 3]),
        max_contact_force=0.0,
        allowed_touch_objects=list(touched),
    )


def _translation(header: Header, turn: NDArray[np.float64], way: NDArray[np.float64]) -> Any:
    from moveit_msgs.msg import GripperTranslation  # type: ignore[import-not-found]

    length = float(np.linalg.norm(way))
    x, y, z = (turn.T @ way / length).tolist() if length > 0 else (0.0, 0.0, 0.0)
    message = GripperTranslation()
    message.direction.header = header
    message.direction.vector = Vector3(x=x, y=y, z=z)
    message.desired_distance = length
    message.min_distance = SHORTEST * length
    return message


def _trajectory(header: Header, posture: JointState, max_effort: float) -> JointTrajectory:
    point = JointTrajectoryPoint(
        positions=list(posture.position),
        effort=[max_effort] * len(posture.name) if max_effort else [],
        time_from_start=Duration(sec=1),
    )
    # Postures hold at any time: a stamp of 0 is "now".
    return JointTrajectory(
        header=Header(frame_id=header.frame_id), joint_names=list(posture.name), points=[point]
    )

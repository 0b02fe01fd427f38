"""Grasps as MoveIt takes them; with messages of the same fields where MoveIt is not installed."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from megrasp_msgs.msg import Grasp, GraspArray
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import matrix_from_pose7
from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.moveit import first_that_plans, to_moveit_grasps
from megrasp_ros.server.grasp_messages import grasp_array


@dataclass
class GripperTranslation:
    """moveit_msgs/GripperTranslation."""

    direction: Vector3Stamped = field(default_factory=Vector3Stamped)
    desired_distance: float = 0.0
    min_distance: float = 0.0


@dataclass
class MoveItGrasp:
    """moveit_msgs/Grasp."""

    id: str = ""
    pre_grasp_posture: JointTrajectory = field(default_factory=JointTrajectory)
    grasp_posture: JointTrajectory = field(default_factory=JointTrajectory)
    grasp_pose: PoseStamped = field(default_factory=PoseStamped)
    grasp_quality: float = 0.0
    pre_grasp_approach: GripperTranslation = field(default_factory=GripperTranslation)
    post_grasp_retreat: GripperTranslation = field(default_factory=GripperTranslation)
    post_place_retreat: GripperTranslation = field(default_factory=GripperTranslation)
    max_contact_force: float = 0.0
    allowed_touch_objects: list[str] = field(default_factory=list)


INSTALLED = importlib.util.find_spec("moveit_msgs") is not None


@pytest.fixture(autouse=True)
def messages(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    if not INSTALLED:
        package, module = ModuleType("moveit_msgs"), ModuleType("moveit_msgs.msg")
        module.Grasp, module.GripperTranslation = MoveItGrasp, GripperTranslation  # type: ignore
        monkeypatch.setitem(sys.modules, "moveit_msgs", package)
        monkeypatch.setitem(sys.modules, "moveit_msgs.msg", module)
    yield


def some_grasps(count: int = 3) -> GraspArray:
    """Grasps of the 2F-85, tilted, half open, 10 cm approach, 20 cm up as retreat."""
    gripper = load_gripper("robotiq_2f85")
    found = []
    for rank in range(count):
        tilt = 0.2 * rank
        down = np.array([math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0])
        tcp = matrix_from_pose7(np.array([0.4, 0.1 * rank, 0.05, *down]))
        base = tcp @ np.linalg.inv(gripper.gripper_from_tcp)
        back, up = base.copy(), base.copy()
        back[:3, 3] -= 0.1 * base[:3, 2]
        up[2, 3] += 0.2
        found.append(
            SimpleNamespace(
                world_from_gripper=base,
                world_from_tcp=tcp,
                world_from_gripper_approach=back,
                world_from_gripper_retreat=up,
                share=0.5,
                width=0.03,
                score=0.9 - 0.1 * rank,
                clearance=0.01,
                tilt=tilt,
                collision_free=True,
                width_tolerance=0.004,
                opening=0.04,
                object=None,
            )
        )
    header = Header(frame_id="base_link")
    header.stamp.sec = 12
    return grasp_array(gripper, found, header=header, model_id="m", seed=1)


def vector(translation) -> np.ndarray:
    v = translation.direction.vector
    return np.array([v.x, v.y, v.z])


def test_every_field_says_what_moveit_means_by_it() -> None:
    grasps = some_grasps()
    converted = to_moveit_grasps(grasps, max_effort=20.0, allowed_touch_objects=["bin"])
    assert [one.id for one in converted] == [f"robotiq_2f85_{rank}" for rank in range(3)]
    assert [one.grasp_quality for one in converted] == pytest.approx([0.9, 0.8, 0.7])
    for ours, theirs in zip(grasps.grasps, converted, strict=True):
        assert theirs.grasp_pose.header == grasps.header
        pose = matrix_from_pose(theirs.grasp_pose.pose, "grasp_pose")
        assert np.allclose(pose, matrix_from_pose(ours.pregrasp, "pregrasp"), atol=1e-9)
        base, approach = (matrix_from_pose(p, "pose") for p in (ours.pregrasp, ours.approach))
        assert theirs.pre_grasp_approach.direction.header.frame_id == "base_link"
        assert theirs.pre_grasp_approach.desired_distance == pytest.approx(0.1)
        assert 0 < theirs.pre_grasp_approach.min_distance < 0.1
        reached = approach[:3, 3] + 0.1 * vector(theirs.pre_grasp_approach)
        assert np.allclose(reached, base[:3, 3], atol=1e-6)
        assert np.allclose(vector(theirs.post_grasp_retreat), (0, 0, 1))
        assert theirs.post_grasp_retreat.desired_distance == pytest.approx(0.2)
        backwards = vector(theirs.post_place_retreat)
        assert np.allclose(backwards, -vector(theirs.pre_grasp_approach))
        assert theirs.pre_grasp_posture.joint_names == list(ours.pregrasp_posture.name)
        (opened,), (closed,) = theirs.pre_grasp_posture.points, theirs.grasp_posture.points
        assert list(opened.positions) == list(ours.pregrasp_posture.position)
        assert list(closed.positions) == list(ours.grasp_posture.position)
        assert list(opened.positions) != list(closed.positions)
        assert not opened.effort and set(closed.effort) == {20.0}
        assert theirs.allowed_touch_objects == ["bin"]


def test_the_pose_of_the_link_that_the_robot_moves() -> None:
    """A flange 12 mm behind the gripper's base, turned by 45 degrees about +Z."""
    gripper_from_flange = matrix_from_pose7(
        np.array([0.0, 0.0, -0.012, 0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8)])
    )
    grasps = some_grasps()
    converted = to_moveit_grasps(grasps, gripper_from_link=gripper_from_flange, link="flange")
    for ours, theirs in zip(grasps.grasps, converted, strict=True):
        base = matrix_from_pose(ours.pregrasp, "pregrasp")
        flange = matrix_from_pose(theirs.grasp_pose.pose, "grasp_pose")
        assert np.allclose(flange, base @ gripper_from_flange, atol=1e-9)
        assert theirs.pre_grasp_approach.direction.header.frame_id == "flange"
        # The approach goes along +Z of the gripper, which is +Z of this flange.
        assert np.allclose(vector(theirs.pre_grasp_approach), (0, 0, 1), atol=1e-6)
        assert theirs.post_grasp_retreat.direction.header.frame_id == "base_link"
    with pytest.raises(InvalidRequestError, match="gripper_from_link"):
        to_moveit_grasps(grasps, gripper_from_link=np.ones((4, 4)))


class FakePlanner:
    """Reaches what is far enough to the left, and remembers what it was asked."""

    def __init__(self, least_y: float) -> None:
        self.least_y, self.asked = least_y, []

    def __call__(self, grasp) -> list[str] | None:
        self.asked.append(grasp.id)
        reached = grasp.grasp_pose.pose.position.y > self.least_y
        return [f"to {grasp.id}"] if reached else None


def test_ranked_grasps_are_tried_until_one_plans() -> None:
    grasps = to_moveit_grasps(some_grasps(5))
    planner = FakePlanner(0.15)
    found = first_that_plans(grasps, planner)
    assert found == (grasps[2], ["to robotiq_2f85_2"])
    assert planner.asked == [f"robotiq_2f85_{rank}" for rank in range(3)]
    assert first_that_plans(grasps, FakePlanner(9.0)) is None
    assert first_that_plans([], FakePlanner(0.0)) is None
    # An empty plan is one: the robot is there already.
    assert first_that_plans(grasps, lambda grasp: []) == (grasps[0], [])


def test_a_grasp_without_a_way_has_no_direction() -> None:
    still = Grasp()
    still.pregrasp.orientation.w = still.approach.orientation.w = 1.0
    still.retreat.orientation.w = 1.0
    (converted,) = to_moveit_grasps(GraspArray(grasps=[still]))
    assert converted.pre_grasp_approach.desired_distance == 0.0
    assert not vector(converted.pre_grasp_approach).any()


@pytest.mark.skipif(INSTALLED, reason="MoveIt is installed")
def test_without_moveit_the_module_still_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moveit_msgs", None)
    monkeypatch.delitem(sys.modules, "moveit_msgs.msg")
    with pytest.raises(ImportError, match="apt install ros-jazzy-moveit-msgs"):
        to_moveit_grasps(some_grasps(1))
    assert to_moveit_grasps(GraspArray()) == []

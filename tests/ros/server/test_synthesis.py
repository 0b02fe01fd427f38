"""What a synthesis answers and publishes, through a real grasp_server process."""

from __future__ import annotations

import numpy as np
import pytest
from cell_processes import until
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import ErrorCode, GraspArray
from megrasp_msgs.srv import ListGrippers
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from server_client import (
    GRIPPERS,
    LATCHED_TOPICS,
    POINTS,
    Client,
    Latest,
    camera,
    cloud_of,
)

from megrasp_core.grippers import load_gripper
from megrasp_ros.conversions import matrix_from_pose


def test_grasps_come_back_best_first_and_in_place(server: Client) -> None:
    cloud = cloud_of(server)
    answer = server.synthesize(num_grasps=5, cloud=cloud, seed=7)
    assert (answer.success, answer.error_code, answer.error_msg) == (True, 0, "")
    grasps = answer.grasps
    assert (grasps.gripper, grasps.model_id, grasps.seed) == ("robotiq_2f85", "quick", 7)
    assert (grasps.header.frame_id, grasps.header.stamp) == ("world", cloud.header.stamp)
    assert [grasp.id for grasp in grasps.grasps] == [0, 1, 2, 3, 4]
    scores = [grasp.score for grasp in grasps.grasps]
    assert scores == sorted(scores, reverse=True)
    gripper = load_gripper("robotiq_2f85")
    for grasp in grasps.grasps:
        tcp, pregrasp, approach = (
            matrix_from_pose(getattr(grasp, name), name)
            for name in ("tcp", "pregrasp", "approach")
        )
        np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.06], atol=0.005)
        np.testing.assert_allclose(pregrasp @ gripper.gripper_from_tcp, tcp, atol=1e-9)
        np.testing.assert_allclose(
            approach[:3, 3], pregrasp[:3, 3] - 0.1 * pregrasp[:3, 2], atol=1e-9
        )
        assert dict(
            zip(grasp.pregrasp_posture.name, grasp.pregrasp_posture.position)
        ) == pytest.approx(gripper.open_joints)
        assert dict(zip(grasp.grasp_posture.name, grasp.grasp_posture.position)) == pytest.approx(
            gripper.closed_joints
        )
    assert [(each.reason, each.count) for each in answer.rejected] == [("collision", 95)]
    assert 0 < answer.timing.total < 5
    assert answer.timing.check == pytest.approx(0.04)


def test_a_seed_is_drawn_stated_and_repeats_the_answer(server: Client) -> None:
    cloud = cloud_of(server)
    first = server.synthesize(num_grasps=3, cloud=cloud)
    other = server.synthesize(num_grasps=3, cloud=cloud)
    again = server.synthesize(num_grasps=3, cloud=cloud, seed=first.grasps.seed)
    assert first.grasps.seed not in (0, other.grasps.seed)
    assert again.grasps == first.grasps
    assert other.grasps.grasps != first.grasps.grasps


def test_the_latest_cloud_is_taken_from_the_topic(server: Client) -> None:
    with camera(server, POINTS):
        answer = server.synthesize(num_grasps=3)
    assert answer.success, answer.error_msg
    assert answer.timing.wait > 0


def test_only_clouds_after_not_before_count(server: Client) -> None:
    limit = server.node.get_clock().now().to_msg()
    with camera(server, POINTS):
        answer = server.synthesize(num_grasps=1, not_before=limit)
        stamp = answer.grasps.header.stamp
        assert (stamp.sec, stamp.nanosec) > (limit.sec, limit.nanosec)
        limit.sec += 60
        late = server.synthesize(num_grasps=1, not_before=limit)
    assert late.error_code == ErrorCode.STALE_CLOUD
    assert "not_before" in late.error_msg


def test_another_gripper_can_be_asked_for_without_a_switch(server: Client) -> None:
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), gripper_name="robotiq_3f")
    assert answer.grasps.gripper == "robotiq_3f"
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"


def test_auto_takes_the_best_of_the_rack(server: Client) -> None:
    assert not server.parameters(rack=list(GRIPPERS))
    try:
        answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), gripper_name="auto")
        assert answer.grasps.gripper in GRIPPERS
    finally:
        server.parameters(rack=[""])


@pytest.mark.parametrize(
    ("on", "cost", "chosen"),
    [
        ("robotiq_2f85", 0.0, "robotiq_3f"),
        ("robotiq_2f85", 0.1, "robotiq_2f85"),
        ("robotiq_3f", 0.1, "robotiq_3f"),
    ],
)
def test_auto_counts_the_cost_of_changing_the_tool(
    server: Client, on: str, cost: float, chosen: str
) -> None:
    """The double scores robotiq_3f 0.05 higher."""
    assert not server.parameters(rack=list(GRIPPERS), model="preferring", swap_cost=cost)
    try:
        assert server.set_gripper(on).success
        answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), gripper_name="auto")
        assert answer.grasps.gripper == chosen
        (note,) = [text for text in answer.notes if text.startswith("of the rack")]
        assert "robotiq_3f 0.95" in note and "robotiq_2f85 0.90" in note
        assert f"less {cost:g} for changing the tool" in note
    finally:
        assert not server.parameters(rack=[""], model="quick", swap_cost=0.0)


def test_short_memory_is_met_with_fewer_poses_at_a_time(server: Client) -> None:
    assert not server.parameters(model="short")
    answer = server.synthesize(num_grasps=3, cloud=cloud_of(server))
    assert answer.success, answer.error_msg
    assert len(answer.grasps.grasps) == 3
    assert any("8 poses were computed at a time" in note for note in answer.notes)
    assert not server.parameters(model="quick")
    assert not any("at a time" in n for n in server.synthesize(cloud=cloud_of(server)).notes)


def test_poses_are_published_latched_with_the_clouds_stamp(server: Client) -> None:
    cloud = cloud_of(server)
    answer = server.synthesize(num_grasps=4, cloud=cloud)
    # Subscribed after the publication: latched topics bring the last message all the same.
    topics = {name: Latest(server, kind, name) for name, kind in LATCHED_TOPICS.items()}
    assert until(lambda: all(topic.messages for topic in topics.values()))
    grasps = answer.grasps.grasps
    assert topics["pregrasps"].last.poses == [grasp.pregrasp for grasp in grasps]
    assert topics["approach_poses"].last.poses == [grasp.approach for grasp in grasps]
    assert topics["grasps"].last == answer.grasps
    assert topics["pregrasps"].last.header == answer.grasps.header
    assert topics["active_gripper"].last.name == "robotiq_2f85"


@pytest.mark.parametrize("topic", LATCHED_TOPICS)
def test_state_topics_are_reliable_and_latched(server: Client, topic: str) -> None:
    assert until(lambda: bool(server.node.get_publishers_info_by_topic(topic)))
    (info,) = server.node.get_publishers_info_by_topic(topic)
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_points_is_subscribed_best_effort_and_only_while_needed(server: Client) -> None:
    def subscriptions():
        return server.node.get_subscriptions_info_by_topic("points")

    assert until(lambda: not subscriptions())
    assert not server.parameters(points_subscription="continuous")
    assert until(lambda: bool(subscriptions()))
    (info,) = subscriptions()
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert not server.parameters(points_subscription="on_demand")
    assert until(lambda: not subscriptions())


def test_tcp_poses_are_published_on_demand(server: Client) -> None:
    assert not server.parameters(pose_reference="tcp")
    answer = server.synthesize(num_grasps=2, cloud=cloud_of(server))
    topic = Latest(server, PoseArray, "pregrasps")
    assert until(lambda: bool(topic.messages))
    for pose, grasp in zip(topic.last.poses, answer.grasps.grasps, strict=True):
        np.testing.assert_allclose(
            matrix_from_pose(pose, "pose"), matrix_from_pose(grasp.tcp, "tcp"), atol=1e-9
        )


def test_clouds_are_answered_by_themselves_in_auto_mode(server: Client) -> None:
    topic = Latest(server, GraspArray, "grasps")
    assert not server.parameters(auto_synthesize="on_cloud", auto_period=0.1)
    with camera(server, POINTS):
        assert until(lambda: len([m for m in topic.messages if m.grasps]) >= 2)
    assert not server.parameters(auto_synthesize="off")

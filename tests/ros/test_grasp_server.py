"""grasp_server as a process: services, action, topics, errors of bad input; a test double computes."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest
from geometry_msgs.msg import Pose, PoseArray, Vector3
from megrasp_core.grippers import load_gripper
from megrasp_msgs.msg import ErrorCode, GraspArray, GripperInfo, OrientedBox
from megrasp_msgs.srv import ListGrippers, ReloadGrippers, SetGripper, SynthesizeGrasps
from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.qos import LATCHED
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from server_client import (
    GRIPPERS,
    Client,
    camera,
    result,
    running_server,
    seconds_since,
    stamped_cloud,
    table_points,
    until,
)
from std_msgs.msg import String

POINTS = table_points()
LATCHED_TOPICS = {
    "pregrasps": PoseArray,
    "approach_poses": PoseArray,
    "grasps": GraspArray,
    "active_gripper": GripperInfo,
}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("grasp_server")
    with running_server(1, folder, cloud_timeout=0.7, model="quick", device="cpu") as (client, processes):
        yield client, processes


@pytest.fixture
def server(running) -> Client:
    """Return a client of the server in its first state."""
    client, processes = running
    assert not client.parameters(
        model="quick",
        planning_frame="",
        extrinsics=[0.0] * 7,
        gravity=[0.0] * 3,
        region__size=[0.0] * 3,
        pose_reference="gripper",
        auto_synthesize="off",
        points_subscription="on_demand",
        tool_changer="",
    )
    assert client.set_gripper("robotiq_2f85").success
    yield client
    assert processes.running["grasp_server"].poll() is None, "the node died"


def cloud_of(client: Client, points: np.ndarray = POINTS, frame: str = "world") -> PointCloud2:
    return stamped_cloud(client.node, points, frame)


def still_serves(client: Client) -> bool:
    answer = client.synthesize(num_grasps=2, cloud=cloud_of(client))
    return answer.success and len(answer.grasps.grasps) == 2


class Latest:
    """The messages of a latched topic."""

    def __init__(self, client: Client, kind: type, topic: str) -> None:
        self.messages: list = []
        self.subscription = client.node.create_subscription(kind, topic, self.messages.append, LATCHED)

    @property
    def last(self):
        return self.messages[-1]


# --- synthesis ------------------------------------------------------------------------------------------------


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
            matrix_from_pose(getattr(grasp, name), name) for name in ("tcp", "pregrasp", "approach")
        )
        np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.06], atol=0.005)
        np.testing.assert_allclose(pregrasp @ gripper.gripper_from_tcp, tcp, atol=1e-9)
        np.testing.assert_allclose(approach[:3, 3], pregrasp[:3, 3] - 0.1 * pregrasp[:3, 2], atol=1e-9)
        assert dict(zip(grasp.pregrasp_posture.name, grasp.pregrasp_posture.position)) == pytest.approx(
            gripper.open_joints
        )
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


# --- frames ---------------------------------------------------------------------------------------------------

DOWN_CAMERA = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]  # 1 m up, half a turn about x: looks down


def optical_points() -> np.ndarray:
    """Return the table as the camera of DOWN_CAMERA sees it."""
    return (POINTS - [0, 0, 1]) * [1, -1, -1]


def test_an_optical_frame_needs_gravity(server: Client) -> None:
    cloud = cloud_of(server, optical_points(), "camera_optical_frame")
    refused = server.synthesize(num_grasps=1, cloud=cloud)
    assert refused.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "gravity: [0.0, 0.0, 1.0]" in refused.error_msg
    assert not server.parameters(gravity=[0.0, 0.0, 2.0])
    answer = server.synthesize(num_grasps=1, cloud=cloud)
    assert answer.success, answer.error_msg
    tcp = matrix_from_pose(answer.grasps.grasps[0].tcp, "tcp")
    np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.94], atol=0.005)


def test_extrinsics_lead_into_the_planning_frame(server: Client) -> None:
    assert not server.parameters(extrinsics=DOWN_CAMERA)
    cloud = cloud_of(server, optical_points(), "camera_optical_frame")
    unnamed = server.synthesize(num_grasps=1, cloud=cloud)
    assert unnamed.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "planning_frame" in unnamed.error_msg
    assert not server.parameters(planning_frame="base_link")
    answer = server.synthesize(num_grasps=1, cloud=cloud)
    assert answer.grasps.header.frame_id == "base_link"
    tcp = matrix_from_pose(answer.grasps.grasps[0].tcp, "tcp")
    np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.06], atol=0.005)


def test_a_missing_transform_is_error_103(server: Client) -> None:
    assert not server.parameters(planning_frame="base_link")
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "extrinsics" in answer.error_msg
    assert not server.parameters(planning_frame="")
    assert still_serves(server)


# --- bad input ------------------------------------------------------------------------------------------------


def box(size: tuple[float, float, float], z: float = 0.05) -> OrientedBox:
    region = OrientedBox(size=Vector3(x=size[0], y=size[1], z=size[2]))
    region.pose.position.z = z
    return region


def without_z(client: Client) -> PointCloud2:
    cloud = cloud_of(client)
    cloud.fields = cloud.fields[:2]
    return cloud


BAD_REQUESTS = {
    "no grasps": (lambda c: {"num_grasps": 0}, ErrorCode.INVALID_REQUEST, ["num_grasps is 0", "1 to 1000"]),
    "a million grasps": (lambda c: {"num_grasps": 10**6}, ErrorCode.INVALID_REQUEST, ["1000000", "max_num_grasps"]),
    "max_tilt": (lambda c: {"max_tilt": -0.5}, ErrorCode.INVALID_REQUEST, ["max_tilt is -0.5"]),
    "timeout": (lambda c: {"timeout": math.nan}, ErrorCode.INVALID_REQUEST, ["timeout is nan"]),
    "radius": (lambda c: {"exclude_radius": -1.0}, ErrorCode.INVALID_REQUEST, ["exclude_radius"]),
    "excluded pose": (
        lambda c: {"exclude": [Pose(), Pose(orientation=Pose().orientation.__class__(w=0.0))]},
        ErrorCode.INVALID_REQUEST,
        ["exclude[1]", "unit quaternion"],
    ),
    "region": (lambda c: {"region": box((0.1, -0.1, 0.1))}, ErrorCode.INVALID_REQUEST, ["over 0"]),
    "no cloud": (lambda c: {"cloud": PointCloud2()}, ErrorCode.NO_CLOUD, ["/points", "0 publisher(s)", "remap"]),
    "all NaN": (
        lambda c: {"cloud": cloud_of(c, np.full((5, 3), np.nan))}, ErrorCode.BAD_CLOUD, ["none of the 5", "finite"]
    ),
    "no z": (lambda c: {"cloud": without_z(c)}, ErrorCode.BAD_CLOUD, ["lacks z"]),
    "unknown gripper": (
        lambda c: {"gripper_name": "hook"}, ErrorCode.UNKNOWN_GRIPPER, ["'hook'", "robotiq_2f85"]
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_REQUESTS)
def test_bad_input_is_answered_and_the_node_keeps_serving(server: Client, case: str) -> None:
    fields, code, words = BAD_REQUESTS[case]
    request = {"num_grasps": 3, "cloud": cloud_of(server), **fields(server)}
    answer = server.synthesize(**request)
    assert not answer.success
    assert answer.error_code == code, answer.error_msg
    assert all(word in answer.error_msg for word in words), answer.error_msg
    assert not answer.grasps.grasps
    assert still_serves(server)


def test_minus_one_grasps_cannot_even_be_sent() -> None:
    with pytest.raises(AssertionError):
        SynthesizeGrasps.Request(num_grasps=-1)


def test_an_empty_cloud_on_the_topic_is_error_102(server: Client) -> None:
    with camera(server, np.empty((0, 3))):
        answer = server.synthesize(num_grasps=1)
    assert answer.error_code == ErrorCode.BAD_CLOUD, answer.error_msg
    assert "empty" in answer.error_msg


def test_a_cloud_with_an_old_stamp_is_error_101(server: Client) -> None:
    with camera(server, POINTS, age=30.0):
        answer = server.synthesize(num_grasps=1)
    assert answer.error_code == ErrorCode.STALE_CLOUD, answer.error_msg
    assert "cloud_max_age" in answer.error_msg
    assert still_serves(server)


def test_an_empty_table_is_error_401_and_clears_the_poses(server: Client) -> None:
    assert still_serves(server)
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server, table_points(objects=False)))
    assert answer.error_code == ErrorCode.BIN_EMPTY, answer.error_msg
    topic = Latest(server, PoseArray, "pregrasps")
    assert until(lambda: bool(topic.messages))
    assert not topic.last.poses


@pytest.mark.parametrize(
    ("model", "code", "words"),
    [
        ("none", ErrorCode.NO_GRASP_FOUND, ["none of 100 drawn grasps", "collision 100", "another gripper"]),
        ("memory", ErrorCode.OUT_OF_MEMORY, ["no room for 3 poses", "drawn"]),
        ("broken", ErrorCode.INTERNAL, ["KeyError", "log"]),
        ("damaged", ErrorCode.MODEL_NOT_LOADED, ["model.safetensors", "expected"]),
    ],
)
def test_a_failing_model_is_answered_and_can_be_replaced(
    server: Client, model: str, code: int, words: list[str]
) -> None:
    assert not server.parameters(model=model)
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.error_code == code, answer.error_msg
    assert all(word in answer.error_msg for word in words), answer.error_msg
    assert [each.reason for each in answer.rejected] == (["collision"] if model == "none" else [])
    assert not server.parameters(model="quick")
    assert still_serves(server)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"gravity": [0.0, 1.0]}, "3 finite numbers"),
        ({"extrinsics": [0.0, 0, 0, 0, 0, 0, 3.0]}, "unit quaternion"),
        ({"region__size": [0.4, 0.0, 0.2]}, "edges over 0"),
        ({"pose_reference": "wrist"}, "gripper, tcp, flange"),
        ({"num_grasps": 0}, "num_grasps"),
        ({"approach_distance": 5.0}, "approach_distance"),
        ({"drawn": 1.5}, "drawn"),
    ],
)
def test_parameters_out_of_range_are_refused(server: Client, values: dict, words: str) -> None:
    refusals = server.parameters(**{k: [float(x) for x in v] if isinstance(v, list) else v for k, v in values.items()})
    assert len(refusals) == 1
    assert words in refusals[0]


# --- grippers -------------------------------------------------------------------------------------------------


def test_a_new_gripper_clears_the_poses_before_the_answer(server: Client) -> None:
    topics = {name: Latest(server, kind, name) for name, kind in LATCHED_TOPICS.items()}
    assert still_serves(server)
    assert until(lambda: all(topic.messages for topic in topics.values()) and topics["grasps"].last.grasps)
    answer = server.set_gripper("robotiq_3f")
    assert (answer.success, answer.error_code, answer.gripper.name) == (True, 0, "robotiq_3f")
    assert set(GRIPPERS) <= set(answer.available)
    assert until(lambda: not topics["grasps"].last.grasps)
    assert not topics["pregrasps"].last.poses
    assert not topics["approach_poses"].last.poses
    assert until(lambda: topics["active_gripper"].last.name == "robotiq_3f")
    assert server.synthesize(num_grasps=1, cloud=cloud_of(server)).grasps.gripper == "robotiq_3f"


def test_a_dry_run_changes_nothing(server: Client) -> None:
    grasps = Latest(server, GraspArray, "grasps")
    assert still_serves(server)
    answer = server.set_gripper("robotiq_3f", dry_run=True)
    assert (answer.success, answer.gripper.name) == (True, "robotiq_3f")
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert until(lambda: bool(grasps.messages))
    assert grasps.last.grasps


def test_gripper_info_is_complete(server: Client) -> None:
    listed = server.call(ListGrippers.Request())
    infos = {info.name: info for info in listed.grippers}
    assert set(GRIPPERS) <= set(infos)
    gripper, info = load_gripper("robotiq_2f85"), infos["robotiq_2f85"]
    assert info.kind == "adaptive" or info.kind == "parallel"
    assert info.display_name == gripper.description.display_name
    assert info.description_hash == gripper.hash
    assert dict(zip(info.joint_names, info.open_positions)) == pytest.approx(gripper.open_joints)
    assert dict(zip(info.joint_names, info.closed_positions)) == pytest.approx(gripper.closed_joints)
    assert info.max_width == pytest.approx(gripper.description.max_width)
    assert matrix_from_pose(info.gripper_from_tcp, "tcp")[:3, 3] == pytest.approx(gripper.tcp)
    assert info.seen_in_training
    assert not infos["robotiq_3f"].seen_in_training


@pytest.mark.parametrize("name", ["hook", ""])
def test_an_unknown_gripper_is_error_200_and_the_old_one_stays(server: Client, name: str) -> None:
    answer = server.set_gripper(name)
    assert (answer.success, answer.error_code) == (False, ErrorCode.UNKNOWN_GRIPPER)
    assert set(GRIPPERS) <= set(answer.available)
    assert "robotiq_2f85" in answer.error_msg
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert still_serves(server)


def test_an_unreadable_description_is_error_201(server: Client, tmp_path) -> None:
    folder = tmp_path / "claw"
    folder.mkdir()
    (folder / "gripper.yaml").write_text("format: 1\nname: claw\nteeth: 3\n")
    answer = server.set_gripper(str(folder))
    assert (answer.success, answer.error_code) == (False, ErrorCode.BAD_DESCRIPTION)
    assert "teeth" in answer.error_msg or "display_name" in answer.error_msg
    assert not server.parameters(gripper_paths=[str(tmp_path)])
    try:
        reloaded = server.call(ReloadGrippers.Request())
        assert not reloaded.success
        assert reloaded.error_code == ErrorCode.BAD_DESCRIPTION
        assert [line.split(":")[0] for line in reloaded.failed] == ["claw"]
        assert "claw" in reloaded.available
    finally:
        assert not server.parameters(gripper_paths=[""])
    assert server.call(ReloadGrippers.Request()).success
    assert still_serves(server)


def test_another_tool_on_the_arm_is_error_203(server: Client) -> None:
    publisher = server.node.create_publisher(String, "tool_id", LATCHED)
    try:
        publisher.publish(String(data="robotiq_3f"))

        def mismatch() -> bool:
            answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
            return answer.error_code == ErrorCode.TOOL_MISMATCH and "robotiq_3f" in answer.error_msg

        assert until(mismatch, 10.0)
        assert server.set_gripper("robotiq_3f").success
        assert still_serves(server)
        publisher.publish(String(data="robotiq_2f85"))
        assert server.set_gripper("robotiq_2f85").success
        assert until(lambda: still_serves(server), 10.0)
    finally:
        publisher.publish(String(data=""))
        assert until(lambda: still_serves(server), 10.0)
        server.node.destroy_publisher(publisher)


def test_a_missing_tool_changer_is_error_202(server: Client) -> None:
    from megrasp_msgs.srv import ChangeTool

    def change(request, response):
        response.success = request.gripper_name != "robotiq_3f"
        response.message = "" if response.success else "the rack is jammed"
        response.mounted = request.gripper_name if response.success else ""
        return response

    service = server.node.create_service(ChangeTool, "changer/change_tool", change)
    try:
        assert not server.parameters(tool_changer="changer/change_tool")
        answer = server.set_gripper("robotiq_3f")
        assert answer.error_code == ErrorCode.TOOL_CHANGE_FAILED, answer.error_msg
        assert "the rack is jammed" in answer.error_msg
        assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
        assert server.set_gripper("robotiq_2f85").success
    finally:
        server.parameters(tool_changer="")
        server.node.destroy_service(service)


# --- action and concurrency -----------------------------------------------------------------------------------


def test_the_action_gives_feedback_and_the_services_result(server: Client) -> None:
    heard: list = []
    handle = server.goal(num_grasps=3, cloud=cloud_of(server), feedback=lambda m: heard.append(m.feedback))
    answer = result(handle.get_result_async())
    assert answer.status == 4  # GoalStatus.STATUS_SUCCEEDED
    assert len(answer.result.grasps.grasps) == 3
    assert until(lambda: any(each.phase == "check" for each in heard))
    steps = [each for each in heard if each.phase == "sample"]
    assert steps
    assert all(each.total_steps == 20 for each in steps)
    assert {each.phase for each in heard} <= {"wait", "perceive", "encode", "sample", "check"}


def test_cancelling_stops_within_one_step(server: Client) -> None:
    heard = threading.Event()
    assert not server.parameters(model="slow")
    handle = server.goal(
        num_grasps=3, cloud=cloud_of(server), feedback=lambda m: m.feedback.phase == "sample" and heard.set()
    )
    finished = handle.get_result_async()
    assert heard.wait(20)
    start = time.monotonic()
    handle.cancel_goal_async()
    answer = result(finished)
    assert seconds_since(start) < 2 * 0.25 + 1.0
    assert answer.status == 5  # GoalStatus.STATUS_CANCELED
    assert answer.result.error_code == ErrorCode.CANCELLED
    assert not server.parameters(model="quick")
    assert still_serves(server)


def test_waiting_for_a_cloud_can_be_cancelled(server: Client) -> None:
    assert not server.parameters(cloud_timeout=60.0)
    try:
        handle = server.goal(num_grasps=3)
        finished = handle.get_result_async()
        time.sleep(0.2)
        start = time.monotonic()
        handle.cancel_goal_async()
        assert result(finished).result.error_code == ErrorCode.CANCELLED
        assert seconds_since(start) < 2.0
    finally:
        assert not server.parameters(cloud_timeout=0.7)


def test_everything_else_is_busy_meanwhile_unless_it_preempts(server: Client) -> None:
    assert not server.parameters(model="slow")
    heard = threading.Event()
    first = server.goal(num_grasps=1, cloud=cloud_of(server), feedback=lambda _: heard.set())
    first_result = first.get_result_async()
    assert heard.wait(20)
    answers = [
        server.call(SynthesizeGrasps.Request(num_grasps=1, cloud=cloud_of(server))),
        server.call(SetGripper.Request(gripper_name="robotiq_3f")),
        server.call(ReloadGrippers.Request()),
        result(server.goal(num_grasps=1, cloud=cloud_of(server)).get_result_async()).result,
    ]
    assert [answer.error_code for answer in answers] == [ErrorCode.BUSY] * 4
    assert "generate_grasps" in answers[0].error_msg
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert not server.parameters(model="quick")
    second = result(server.goal(num_grasps=1, cloud=cloud_of(server), preempt=True).get_result_async())
    assert second.result.success, second.result.error_msg
    assert result(first_result).result.error_code == ErrorCode.CANCELLED
    assert still_serves(server)


def test_a_request_ends_at_its_timeout(server: Client) -> None:
    assert not server.parameters(model="slow")
    start = time.monotonic()
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), timeout=0.6)
    assert answer.error_code == ErrorCode.TIMEOUT, answer.error_msg
    assert seconds_since(start) < 3.0
    assert not server.parameters(model="quick")
    assert still_serves(server)

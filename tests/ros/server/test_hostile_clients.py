"""What clients should not send, and does no harm: each is answered with the right code, and the
node goes on. Faults that once ended or blocked it.
"""

from __future__ import annotations

import array
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from builtin_interfaces.msg import Time
from cell_processes import in_executor, result, until
from geometry_msgs.msg import PoseArray
from lifecycle_msgs.srv import ChangeState
from megrasp_msgs.msg import ErrorCode, GraspArray
from megrasp_msgs.srv import ListGrippers, SynthesizeGrasps
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2, PointField
from server_client import POINTS, Client, Latest, camera, cloud_of, still_serves

from megrasp_ros.errors import MOST_TEXT


def changed(client: Client, **fields: Any) -> PointCloud2:
    """Return a good cloud with other fields."""
    cloud = cloud_of(client)
    for name, value in fields.items():
        setattr(cloud, name, value)
    return cloud


def stamped(client: Client, ahead: float) -> PointCloud2:
    cloud = cloud_of(client)
    cloud.header.stamp.sec += round(ahead)
    return cloud


def in_frame(client: Client, frame: str) -> PointCloud2:
    cloud = cloud_of(client)
    cloud.header.frame_id = frame
    return cloud


def with_outlier(client: Client) -> PointCloud2:
    points = np.vstack([POINTS, [[1e300, -1e300, 1e300]]]).astype("<f8")
    fields = [
        PointField(name=name, offset=8 * i, datatype=PointField.FLOAT64, count=1)
        for i, name in enumerate("xyz")
    ]
    data = array.array("B", points.tobytes())
    return changed(client, width=len(points), point_step=24, fields=fields, data=data)


def given_twice(client: Client) -> PointCloud2:
    cloud = cloud_of(client)
    cloud.fields = [*cloud.fields, cloud.fields[0]]
    return cloud


def after_the_cloud(client: Client) -> dict[str, Any]:
    cloud = cloud_of(client)
    limit = Time(sec=cloud.header.stamp.sec + 1)
    return {"cloud": cloud, "not_before": limit}


REQUESTS: dict[str, tuple[Any, int, str]] = {
    "point_step": (
        lambda c: {"cloud": changed(c, width=1, point_step=2**32 - 1)},
        ErrorCode.BAD_CLOUD,
        "data holds",
    ),
    "field given twice": (
        lambda c: {"cloud": given_twice(c)},
        ErrorCode.BAD_CLOUD,
        "several fields x",
    ),
    "many long fields": (
        lambda c: {"cloud": changed(c, fields=[PointField(name="q" * 10**5)] * 50)},
        ErrorCode.BAD_CLOUD,
        "lacks x, y, z",
    ),
    "no frame": (lambda c: {"cloud": in_frame(c, "")}, ErrorCode.BAD_CLOUD, "frame_id is empty"),
    "a frame of ten megabytes": (
        lambda c: {"cloud": in_frame(c, "f" * 10**7)},
        ErrorCode.BAD_CLOUD,
        "frame_id has 10000000 characters",
    ),
    "from the future": (
        lambda c: {"cloud": stamped(c, 3600)},
        ErrorCode.STALE_CLOUD,
        "ahead of this node's clock",
    ),
    "before 1970": (
        lambda c: {"cloud": stamped(c, -(2**31) + 10**6)},
        ErrorCode.BAD_CLOUD,
        "stamp is -",
    ),
    "older than not_before": (after_the_cloud, ErrorCode.STALE_CLOUD, "before not_before"),
    "not_before 1970": (
        lambda c: {"not_before": Time(sec=-1)},
        ErrorCode.INVALID_REQUEST,
        "not_before.sec is -1",
    ),
    "no such user": (
        lambda c: {"gripper_name": "~nosuchuser"},
        ErrorCode.UNKNOWN_GRIPPER,
        "'~nosuchuser'",
    ),
    "NUL": (lambda c: {"gripper_name": "a\0b"}, ErrorCode.UNKNOWN_GRIPPER, "unknown gripper"),
    "a path": (
        lambda c: {"gripper_name": "/etc/passwd"},
        ErrorCode.UNKNOWN_GRIPPER,
        "unknown gripper '/etc/passwd'",
    ),
    "a name of ten megabytes": (
        lambda c: {"gripper_name": "x" * 10**7},
        ErrorCode.UNKNOWN_GRIPPER,
        "characters left out",
    ),
}


@pytest.mark.parametrize("case", REQUESTS)
def test_a_request_is_answered(server: Client, case: str) -> None:
    fields, code, text = REQUESTS[case]
    answer = server.synthesize(**{"num_grasps": 2, "cloud": cloud_of(server), **fields(server)})
    assert answer.error_code == code, answer.error_msg
    assert text in answer.error_msg
    assert len(answer.error_msg) < MOST_TEXT + 100
    assert "root:" not in answer.error_msg
    assert still_serves(server)


@pytest.mark.parametrize(
    "fields",
    [{"max_tilt": math.pi}, {"max_tilt": float(np.float32(math.pi))}, {"seed": 2**64 - 1}],
)
def test_values_at_the_edge_are_right(server: Client, fields: dict[str, Any]) -> None:
    cloud = with_outlier(server)
    answer = server.synthesize(num_grasps=2, cloud=cloud, **fields)
    assert answer.success, answer.error_msg
    if "seed" in fields:
        assert answer.grasps.seed == fields["seed"]
        assert server.synthesize(num_grasps=2, cloud=cloud, **fields).grasps == answer.grasps


def test_a_timeout_says_what_was_waited_for(server: Client) -> None:
    assert not server.parameters(cloud_timeout=60.0)
    answer = server.synthesize(num_grasps=2, timeout=0.2)
    assert not server.parameters(cloud_timeout=0.7)
    assert answer.error_code == ErrorCode.TIMEOUT
    assert "waiting for a cloud on /points, which has 0 publisher(s)" in answer.error_msg


def test_a_cloud_from_the_future_on_the_topic_is_error_101(server: Client) -> None:
    with camera(server, POINTS, age=-3600.0):
        answer = server.synthesize(num_grasps=1)
    assert answer.error_code == ErrorCode.STALE_CLOUD
    assert "ahead of this node's clock" in answer.error_msg


def test_without_a_clock_the_age_of_clouds_is_not_known(server: Client) -> None:
    assert not server.parameters(use_sim_time=True)
    try:
        with camera(server, POINTS):
            answer = server.synthesize(num_grasps=1)
            assert answer.error_code == ErrorCode.STALE_CLOUD, answer.error_msg
            assert "use_sim_time is true and no /clock" in answer.error_msg
            # Of a cloud in the request no age is asked.
            assert server.synthesize(num_grasps=1, cloud=cloud_of(server)).success
            assert not server.parameters(cloud_max_age=0.0)
            assert server.synthesize(num_grasps=1).success
    finally:
        assert not server.parameters(use_sim_time=False, cloud_max_age=5.0)
    assert still_serves(server)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"gripper_paths": ["~nosuchuser/grippers"]}, "folder that exists"),
        ({"gripper_paths": ["/" + "x" * 300]}, "folder that exists"),
        ({"gripper_paths": ["/no/such/folder"]}, "folder that exists"),
        ({"gripper_paths": ["a\0b"]}, "folder that exists"),
        ({"gripper": "hook"}, "unknown gripper 'hook'"),
        ({"gripper": "/proc/kmsg"}, "unknown gripper"),
        ({"gripper": "x" * 10**6}, "unknown gripper"),
        ({"rack": ["robotiq_2f85", "hook"]}, "unknown gripper 'hook'"),
        ({"device": "meta"}, "expected auto, cpu, cuda"),
        ({"device": "cuda:99"}, "this machine has"),
        ({"threads": 256}, "cores"),
        ({"tool_changer": "no service/of:this"}, "expected the name of a service"),
        ({"request_timeout": math.nan}, "request_timeout"),
        ({"gravity": [math.nan, 0.0, 0.0]}, "3 finite numbers"),
        ({"gravity": [1e-320, 0.0, 0.0]}, "points somewhere"),
        ({"gravity": [1e308, 1e308, 1e308]}, "3 finite numbers"),
        ({"sensor_origin": [1e300, 0.0, 0.0]}, "3 finite numbers"),
        ({"sensor_origin": [0.0] * 10**5}, "3 finite numbers"),
        ({"region__size": [1e300] * 3}, "3 finite numbers"),
        ({"region__pose": [1e300, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}, "unit quaternion"),
        ({"extrinsics": [1e300, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}, "unit quaternion"),
        ({"floor": [1e-320, 0.0, 0.0, 0.0]}, "expected a normal"),
        ({"floor": [1e308] * 4}, "plane"),
        ({"planning_frame": "x" * 10**6}, "name of a frame"),
        ({"flange_frame": "x" * 10**6}, "name of a frame"),
        ({"flange_from_gripper__robotiq_2f85": [1.0] * 7}, "unit quaternion"),
    ],
)
def test_a_parameter_is_refused_when_it_is_set(
    server: Client, values: dict[str, Any], text: str
) -> None:
    if values == {"threads": 256} and (os.cpu_count() or 1) >= 256:
        pytest.skip("as many cores as the parameter allows")
    (reason,) = server.parameters(**values)
    assert text in reason
    assert len(reason) < MOST_TEXT + 100
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"


@pytest.mark.parametrize("number", [0, 10, 200, 255])
def test_a_malformed_parameter_is_refused(server: Client, number: int) -> None:
    wrong = Parameter(name="gripper", value=ParameterValue(type=number))
    right = Parameter(name="drawn", value=ParameterValue(type=2, integer_value=100))
    answer = server.call(SetParameters.Request(parameters=[right, wrong]))
    assert [each.successful for each in answer.results] == [True, False]
    assert answer.results[1].reason
    assert still_serves(server)


def test_an_impossible_transition_is_answered(server: Client) -> None:
    client = server.node.create_client(ChangeState, "grasp_server/change_state")
    assert client.wait_for_service(60.0)
    for number, label in ((1, ""), (3, ""), (99, ""), (0, "configure"), (0, "x" * 10**5)):
        request = ChangeState.Request()
        request.transition.id, request.transition.label = number, label
        answer = result(in_executor(server.node, lambda r=request: client.call_async(r)))
        assert not answer.success
    assert still_serves(server)


def test_another_grippers_grasps_are_answered_and_not_published(server: Client) -> None:
    assert still_serves(server)
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), gripper_name="robotiq_3f")
    assert answer.success and answer.grasps.gripper == "robotiq_3f"
    poses, grasps = Latest(server, PoseArray, "pregrasps"), Latest(server, GraspArray, "grasps")
    assert until(lambda: bool(poses.messages and grasps.messages))
    assert (grasps.last.gripper, len(poses.last.poses)) == ("robotiq_2f85", 2)


def test_of_fifty_calls_none_vanishes(server: Client) -> None:
    request = SynthesizeGrasps.Request(num_grasps=1, cloud=cloud_of(server))
    futures = [server.start(request) for _ in range(50)]
    codes = [result(future).error_code for future in futures]
    assert set(codes) <= {ErrorCode.NONE, ErrorCode.BUSY}
    assert ErrorCode.NONE in codes


def test_many_lists_at_once_are_answered_and_hold_nobody_up(server: Client) -> None:
    futures = [server.start(ListGrippers.Request()) for _ in range(50)]
    assert still_serves(server)
    names = {tuple(info.name for info in result(future).grippers) for future in futures}
    assert len(names) == 1 and "robotiq_2f85" in next(iter(names))


@pytest.mark.parametrize("preempt", [False, True])
def test_of_two_hundred_goals_none_vanishes(server: Client, preempt: bool) -> None:
    from megrasp_msgs.action import GenerateGrasps

    # A client that can take as many answers: rclpy's default keeps ten.
    deep = QoSProfile(depth=1000)
    client = ActionClient(
        server.node,
        GenerateGrasps,
        "generate_grasps",
        goal_service_qos_profile=deep,
        result_service_qos_profile=deep,
    )
    assert client.wait_for_server(60.0)
    cloud, codes = cloud_of(server), []

    def ask(future: Any) -> None:
        assert future.result().accepted
        future.result().get_result_async().add_done_callback(
            lambda answer: codes.append(answer.result().result.error_code)
        )

    def send() -> None:
        for _ in range(200):
            goal = GenerateGrasps.Goal(num_grasps=1, cloud=cloud, preempt=preempt)
            client.send_goal_async(goal).add_done_callback(ask)

    in_executor(server.node, send)
    assert until(lambda: len(codes) == 200)
    refused = ErrorCode.CANCELLED if preempt else ErrorCode.BUSY
    assert set(codes) == {ErrorCode.NONE, refused}
    in_executor(server.node, client.destroy)
    assert still_serves(server)


def test_finished_goals_let_go_of_their_clouds(running: tuple, server: Client) -> None:
    process = psutil.Process(running[1].running["grasp_server"].pid)
    large = np.zeros((500_000, 3), np.float32)
    large[:] = np.nan
    cloud = cloud_of(server, large)

    def goal() -> None:
        answer = result(server.outcome(server.goal(num_grasps=1, cloud=cloud)))
        assert answer.result.error_code == ErrorCode.BAD_CLOUD

    for _ in range(3):
        goal()
    before = process.memory_info().rss
    for _ in range(20):
        goal()
    # Twenty clouds are 114 MiB.
    assert until(lambda: process.memory_info().rss - before < 60 * 2**20, 15.0)


def test_a_description_that_blocks_is_left_out(server: Client, tmp_path: Path) -> None:
    folder = tmp_path / "stalled"
    folder.mkdir()
    os.mkfifo(folder / "gripper.yaml")
    assert not server.parameters(gripper_paths=[str(tmp_path)], allow_paths=True)
    try:
        for name in ("stalled", str(folder), str(folder / "gripper.yaml"), "/proc/kmsg"):
            assert server.set_gripper(name).error_code == ErrorCode.UNKNOWN_GRIPPER
        assert server.call(ListGrippers.Request()).grippers
    finally:
        assert not server.parameters(gripper_paths=[""], allow_paths=False)
    assert still_serves(server)

"""Bad input: the right error, a message that helps, and a node that keeps serving."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cell_processes import in_executor, until
from geometry_msgs.msg import Pose, PoseArray, Vector3
from megrasp_msgs.msg import ErrorCode, OrientedBox
from sensor_msgs.msg import PointCloud2
from server_client import (
    POINTS,
    Client,
    Latest,
    camera,
    cloud_of,
    still_serves,
    table_points,
)

from megrasp_ros.qos import SENSOR


def box(size: tuple[float, float, float], z: float = 0.05) -> OrientedBox:
    region = OrientedBox(size=Vector3(x=size[0], y=size[1], z=size[2]))
    region.pose.position.z = z
    return region


def without_z(client: Client) -> PointCloud2:
    cloud = cloud_of(client)
    cloud.fields = cloud.fields[:2]
    return cloud


BAD_REQUESTS = {
    "no grasps": (
        lambda c: {"num_grasps": 0},
        ErrorCode.INVALID_REQUEST,
        ["num_grasps is 0", "1 to 1000"],
    ),
    "a million grasps": (
        lambda c: {"num_grasps": 10**6},
        ErrorCode.INVALID_REQUEST,
        ["1000000", "max_num_grasps"],
    ),
    "max_tilt": (lambda c: {"max_tilt": -0.5}, ErrorCode.INVALID_REQUEST, ["max_tilt is -0.5"]),
    "timeout": (lambda c: {"timeout": math.nan}, ErrorCode.INVALID_REQUEST, ["timeout is nan"]),
    "radius": (lambda c: {"exclude_radius": -1.0}, ErrorCode.INVALID_REQUEST, ["exclude_radius"]),
    "excluded pose": (
        lambda c: {"exclude": [Pose(), Pose(orientation=Pose().orientation.__class__(w=0.0))]},
        ErrorCode.INVALID_REQUEST,
        ["exclude[1]", "unit quaternion"],
    ),
    "region": (lambda c: {"region": box((0.1, -0.1, 0.1))}, ErrorCode.INVALID_REQUEST, ["over 0"]),
    "region in millimetres": (
        lambda c: {"region": box((400.0, 300.0, 150.0))},
        ErrorCode.INVALID_REQUEST,
        ["400 x 300 x 150", "looks like millimetres"],
    ),
    "region of a galaxy": (
        lambda c: {"region": box((1e300, 1e300, 1e300))},
        ErrorCode.INVALID_REQUEST,
        ["up to 1000000"],
    ),
    "no cloud": (
        lambda c: {"cloud": PointCloud2()},
        ErrorCode.NO_CLOUD,
        ["/points", "0 publisher(s)", "remap"],
    ),
    "all NaN": (
        lambda c: {"cloud": cloud_of(c, np.full((5, 3), np.nan))},
        ErrorCode.BAD_CLOUD,
        ["none of the 5", "NaN, infinite or 0 0 0"],
    ),
    "all 0 0 0": (
        lambda c: {"cloud": cloud_of(c, np.zeros((5, 3)))},
        ErrorCode.BAD_CLOUD,
        ["none of the 5", "NaN, infinite or 0 0 0"],
    ),
    "millimetres": (
        lambda c: {"cloud": cloud_of(c, 1000 * POINTS)},
        ErrorCode.BAD_CLOUD,
        ["looks like millimetres", "0.001", "REP 103"],
    ),
    "no z": (lambda c: {"cloud": without_z(c)}, ErrorCode.BAD_CLOUD, ["lacks z"]),
    "unknown gripper": (
        lambda c: {"gripper_name": "hook"},
        ErrorCode.UNKNOWN_GRIPPER,
        ["'hook'", "robotiq_2f85"],
    ),
}


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


def test_minus_one_grasps_cannot_even_be_sent(server: Client) -> None:
    with pytest.raises((AssertionError, OverflowError, SystemError)):
        server.synthesize(num_grasps=-1, cloud=cloud_of(server))
    assert still_serves(server)


def test_an_empty_cloud_on_the_topic_is_error_102(server: Client) -> None:
    with camera(server, np.empty((0, 3))):
        answer = server.synthesize(num_grasps=1)
    assert answer.error_code == ErrorCode.BAD_CLOUD, answer.error_msg
    assert "empty" in answer.error_msg


def test_error_100_names_the_topics_with_clouds(server: Client) -> None:
    elsewhere = server.node.create_publisher(PointCloud2, "camera/points", SENSOR)
    try:
        assert until(lambda: "/camera/points" in server.synthesize(num_grasps=1).error_msg), (
            "and how to take one"
        )
        assert "points:=/camera/points" in server.synthesize(num_grasps=1).error_msg
    finally:
        in_executor(server.node, lambda: server.node.destroy_publisher(elsewhere))


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
        (
            "none",
            ErrorCode.NO_GRASP_FOUND,
            ["none of 100 drawn grasps", "collision 100", "another gripper"],
        ),
        (
            "memory",
            ErrorCode.OUT_OF_MEMORY,
            ["no room for 8 poses", "also with 8 poses at a time", "drawn"],
        ),
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
        ({"region__size": [400.0, 300.0, 150.0]}, "looks like millimetres"),
        ({"pose_reference": "wrist"}, "gripper, tcp, flange"),
        ({"num_grasps": 0}, "num_grasps"),
        ({"approach_distance": 5.0}, "approach_distance"),
        ({"drawn": 1.5}, "INTEGER"),
    ],
)
def test_parameters_out_of_range_are_refused(server: Client, values: dict, words: str) -> None:
    refusals = server.parameters(
        **{k: [float(x) for x in v] if isinstance(v, list) else v for k, v in values.items()}
    )
    assert len(refusals) == 1
    assert words in refusals[0]

"""grasp_server with depth images in place of clouds, and targets."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from cell_processes import until
from depth_client import FRAME, HIGH, LOW, PLACES, depth_camera
from megrasp_msgs.msg import ErrorCode, GraspArray
from sensor_msgs.msg import PointField
from server_client import Client, Latest, cloud_of, still_serves

from megrasp_ros.conversions import matrix_from_pose

DEPTH_TOPICS = ("depth", "camera_info", "mask")


@pytest.fixture
def depth_server(server: Client) -> Iterator[Client]:
    """Return a client of the server that takes depth images."""
    # Other tests' publishers of these topics are gone from the graph before one begins.
    assert until(lambda: not any(server.node.count_publishers(name) for name in DEPTH_TOPICS))
    assert not server.parameters(input="depth", gravity=[0.0, 0.0, 1.0], cloud_timeout=1.5)
    yield server
    assert not server.parameters(
        input="points", gravity=[0.0] * 3, cloud_timeout=0.7, sync_tolerance=0.0
    )
    assert still_serves(server)


def without(*names: str) -> Callable[[dict[str, Any]], None]:
    def change(sent: dict[str, Any]) -> None:
        for name in names:
            del sent[name]

    return change


def place(answer: Any) -> np.ndarray:
    return matrix_from_pose(answer.grasps.grasps[0].tcp, "tcp")[:3, 3]


@pytest.mark.parametrize(("target", "label"), [(-1, HIGH), (LOW, LOW), (HIGH, HIGH)])
def test_grasps_come_from_a_depth_image_and_its_mask(
    depth_server: Client, target: int, label: int
) -> None:
    with depth_camera(depth_server):
        answer = depth_server.synthesize(num_grasps=2, target=target)
    assert answer.success, answer.error_msg
    assert answer.grasps.header.frame_id == FRAME
    assert [grasp.object for grasp in answer.grasps.grasps] == [label, label]
    np.testing.assert_allclose(place(answer), PLACES[label], atol=0.005)


def test_without_a_mask_there_are_grasps_and_no_targets(depth_server: Client) -> None:
    with depth_camera(depth_server, without("mask")):
        answer = depth_server.synthesize(num_grasps=2)
        assert answer.success, answer.error_msg
        assert [grasp.object for grasp in answer.grasps.grasps] == [-1, -1]
        refused = depth_server.synthesize(num_grasps=2, target=1)
    assert refused.error_code == ErrorCode.INVALID_REQUEST
    assert "target is 1" in refused.error_msg
    assert "nobody publishes a mask on /mask" in refused.error_msg


def test_a_mask_may_come_late(depth_server: Client) -> None:
    with depth_camera(depth_server, late=0.4):
        answer = depth_server.synthesize(num_grasps=2, target=LOW)
    assert answer.success, answer.error_msg
    np.testing.assert_allclose(place(answer), PLACES[LOW], atol=0.005)


def older(name: str, nanoseconds: int) -> Callable[[dict[str, Any]], None]:
    def change(sent: dict[str, Any]) -> None:
        stamp = sent[name].header.stamp
        total = stamp.sec * 10**9 + stamp.nanosec - nanoseconds
        other = type(stamp)()
        other.sec, other.nanosec = divmod(total, 10**9)
        sent[name].header.stamp = other

    return change


def field(topic: str, **fields: Any) -> Callable[[dict[str, Any]], None]:
    def change(sent: dict[str, Any]) -> None:
        for name, value in fields.items():
            setattr(sent[topic], name, value)

    return change


def all_older(sent: dict[str, Any]) -> None:
    for name in sent:
        older(name, 60 * 10**9)(sent)


def all_unnamed(sent: dict[str, Any]) -> None:
    for message in sent.values():
        message.header.frame_id = ""


UNUSABLE: dict[str, tuple[Any, int, list[str]]] = {
    "nothing": (
        without(*DEPTH_TOPICS),
        ErrorCode.NO_CLOUD,
        ["depth image arrived on /depth", "0 publisher(s)", "camera_info arrived on /camera_info"],
    ),
    "no camera_info": (
        without("camera_info"),
        ErrorCode.NO_CLOUD,
        ["no camera_info arrived on /camera_info", "sensor_msgs/msg/CameraInfo"],
    ),
    "no depth": (without("depth"), ErrorCode.NO_CLOUD, ["no depth image arrived on /depth"]),
    "mask of another moment": (
        older("mask", 3 * 10**9 + 7),
        ErrorCode.STALE_CLOUD,
        ["no messages of one moment", "/mask", "sync_tolerance", "publisher of the mask"],
    ),
    "camera_info of another moment": (
        older("camera_info", 3 * 10**9 + 7),
        ErrorCode.STALE_CLOUD,
        ["no messages of one moment", "/camera_info", "sync_tolerance"],
    ),
    "old": (all_older, ErrorCode.STALE_CLOUD, ["newest depth image on /depth", "cloud_max_age"]),
    "no frame": (all_unnamed, ErrorCode.BAD_CLOUD, ["frame_id is empty"]),
    "distorted": (field("camera_info", d=[0.1] * 5), ErrorCode.BAD_CLOUD, ["distorted"]),
    "other size": (field("camera_info", width=64), ErrorCode.BAD_CLOUD, ["64 x 96"]),
    "encoding": (field("depth", encoding="rgb8"), ErrorCode.BAD_CLOUD, ["'rgb8'"]),
    "cut": (field("depth", data=array("B", b"12")), ErrorCode.BAD_CLOUD, ["2 bytes"]),
    "mask of floats": (field("mask", encoding="32FC1"), ErrorCode.BAD_CLOUD, ["mask", "32FC1"]),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_images_that_cannot_be_used_are_answered(depth_server: Client, case: str) -> None:
    change, code, words = UNUSABLE[case]
    with depth_camera(depth_server, change):
        answer = depth_server.synthesize(num_grasps=2)
    assert answer.error_code == code, answer.error_msg
    assert all(word in answer.error_msg for word in words), answer.error_msg


def test_stamps_may_differ_by_the_tolerance(depth_server: Client) -> None:
    assert not depth_server.parameters(sync_tolerance=0.02)
    with depth_camera(depth_server, older("camera_info", 10**7)):
        answer = depth_server.synthesize(num_grasps=2)
    assert answer.success, answer.error_msg


def test_the_axes_of_a_depth_image_are_a_cameras_whatever_its_frame(depth_server: Client) -> None:
    def named(sent: dict[str, Any]) -> None:
        for message in sent.values():
            message.header.frame_id = "scanner"

    assert not depth_server.parameters(gravity=[0.0] * 3)
    with depth_camera(depth_server, named):
        answer = depth_server.synthesize(num_grasps=2)
    assert answer.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING, answer.error_msg
    assert "gravity: [0.0, 0.0, 1.0]" in answer.error_msg


def test_the_topics_are_subscribed_while_they_are_needed(depth_server: Client) -> None:
    def counts() -> list[int]:
        return [
            len(depth_server.node.get_subscriptions_info_by_topic(name))
            for name in ("points", *DEPTH_TOPICS)
        ]

    assert until(lambda: counts() == [0, 0, 0, 0])
    assert not depth_server.parameters(points_subscription="continuous")
    assert until(lambda: counts() == [0, 1, 1, 1])
    assert not depth_server.parameters(input="points")
    assert until(lambda: counts() == [1, 0, 0, 0])
    assert not depth_server.parameters(points_subscription="on_demand")
    assert until(lambda: counts() == [0, 0, 0, 0])


def test_depth_images_are_answered_by_themselves_in_auto_mode(depth_server: Client) -> None:
    topic = Latest(depth_server, GraspArray, "grasps")
    assert not depth_server.parameters(auto_synthesize="on_cloud", auto_period=0.1)
    with depth_camera(depth_server):
        assert until(lambda: len([m for m in topic.messages if m.grasps]) >= 2)
    assert not depth_server.parameters(auto_synthesize="off", auto_period=1.0)
    assert topic.last.header.frame_id == FRAME


def test_a_cloud_in_the_request_counts_all_the_same(depth_server: Client) -> None:
    assert not depth_server.parameters(gravity=[0.0] * 3)
    assert depth_server.synthesize(num_grasps=2, cloud=cloud_of(depth_server)).success


def test_a_target_needs_labels(server: Client) -> None:
    cloud = cloud_of(server)
    answer = server.synthesize(num_grasps=2, cloud=cloud, target=1)
    assert answer.error_code == ErrorCode.INVALID_REQUEST
    assert "no field `label`" in answer.error_msg


@pytest.mark.parametrize(
    ("datatype", "kind"), [(PointField.UINT32, "<u4"), (PointField.UINT8, "u1")]
)
def test_a_cloud_may_bring_labels(server: Client, datatype: int, kind: str) -> None:
    cloud = cloud_of(server)
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3)
    size = np.dtype(kind).itemsize
    packed = np.zeros(len(points), [("xyz", "<f4", 3), ("label", kind)])
    packed["xyz"] = points
    # Half the table is an object; without a target what stands on it is higher.
    packed["label"] = np.where(points[:, 0] < -0.1, 7, 0)
    cloud.fields = [
        *cloud.fields,
        PointField(name="label", offset=12, datatype=datatype, count=1),
    ]
    cloud.point_step, cloud.row_step = 12 + size, (12 + size) * len(points)
    cloud.data = array("B", packed.tobytes())
    assert place(server.synthesize(num_grasps=1, cloud=cloud))[0] == pytest.approx(0.05, abs=0.01)
    answer = server.synthesize(num_grasps=1, cloud=cloud, target=7)
    assert answer.grasps.grasps[0].object == 7
    assert place(answer)[0] == pytest.approx(-0.15, abs=0.02)

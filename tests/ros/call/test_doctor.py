"""Every kind of trouble that doctor knows, made with real nodes."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from cell_processes import WAIT, in_executor, own_domain, spinning_node, until
from depth_client import depth_camera
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from megrasp_msgs.msg import ErrorCode, GraspArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from server_client import Client, camera, cloud_of, still_serves, table_points
from std_msgs.msg import String

from megrasp_ros.call.app import run
from megrasp_ros.call.checks.asked import Asked
from megrasp_ros.call.checks.input import InputChecks
from megrasp_ros.call.checks.server import cloud_topic, health, presence
from megrasp_ros.call.doctor import running_system
from megrasp_ros.client import GraspClient
from megrasp_ros.qos import SENSOR

FOUND = dict[str, tuple[str, str]]

ABOVE = [0.0, 0.0, 0.6]
HOME = {"sensor_origin": [0.0, 0.0, 0.0]}
"""Places of the camera."""
SHORT = 8.0
"""Patience (s) where something is missing for good."""


def looked_at(
    offset: int = 1, *, points: str = "points", namespace: str = "", patience: float = 20.0
) -> FOUND:
    """What -> level and text."""
    with GraspClient.open(
        "doctor", domain_id=own_domain(offset), namespace=namespace, timeout=20.0
    ) as client:
        asked = Asked(client, "grasp_server", seconds=2.0, patience=patience)
        checks, _ = running_system(asked, points)
    return {check.what: (check.level, check.text) for check in checks}


def troubles(found: FOUND) -> dict[str, str]:
    return {what: level for what, (level, _) in found.items() if level != "ok"}


@contextmanager
def set_to(server: Client, before: dict, **values):
    """Parameters of the server, set back at the end."""
    assert not server.parameters(**values)
    try:
        yield
    finally:
        assert not server.parameters(**before)


def test_all_is_well(server: Client, monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain(1)))
    with (
        set_to(server, {"cloud_timeout": 0.7, **HOME}, cloud_timeout=30.0, sensor_origin=ABOVE),
        camera(server, table_points()),
    ):
        found = looked_at()
        assert not troubles(found), found
        assert "active" in found["server"][1] and "robotiq_2f85" in found["health"][1]
        assert "/points: " in found["points"][1] and " MB" in found["points"][1]
        code = run(
            ["doctor", "--seconds", "2", "--timeout", "30", "--out", str(tmp_path / "doctor.json")]
        )
        told = capsys.readouterr().out
    assert code == (1 if "\nfail " in f"\n{told}" else 0)
    for what in ("packages", "shared memory", "domain", "discovery", "Fast DDS", "gravity"):
        assert what in told
    assert (tmp_path / "doctor.json").stat().st_size > 500


def test_no_server_at_all_and_one_elsewhere() -> None:
    found = looked_at(8, patience=1.0)
    assert found["server"][0] == "fail" and "no other node is seen" in found["server"][1]
    assert found["points"][0] == "fail"
    with spinning_node(own_domain(6), "camera"):
        # A client of the test before may still be seen.
        text = looked_at(6, patience=5.0)["server"][1]
        assert "but /camera" in text and "; start it" in text
    with spinning_node(own_domain(6), "grasp_server"):
        found = looked_at(6, namespace="/cell_2", patience=5.0)
        assert found["server"] == (
            "fail", "no grasp_server in namespace /cell_2, but in /; give --namespace /"
        )  # fmt: skip
        # It is there and no lifecycle node.
        with GraspClient.open("doctor", domain_id=own_domain(6), timeout=0.5) as client:
            line, _ = presence(Asked(client, "grasp_server", seconds=1.0, patience=20.0))
        assert line.level == "fail" and "does not tell its state" in line.text


def test_a_server_that_is_not_active_or_of_another_version() -> None:
    with spinning_node(own_domain(6), "other") as other:
        stranger = LifecycleNode("grasp_server", context=other.context)
        assert other.executor is not None
        other.executor.add_node(stranger)
        found = looked_at(6, patience=SHORT)
        assert found["server"][0] == "fail" and "is unconfigured" in found["server"][1]
        assert "health" in found, "where the reason stands"
        in_executor(other, stranger.trigger_configure)
        in_executor(other, stranger.trigger_activate)
        found = looked_at(6, patience=SHORT)
        assert found["server"][0] == "ok"
        assert found["health"][0] == "warn"
        assert found["clock" if "clock" in found else "parameters"][0] == "fail"
        assert "of this version" in found["parameters"][1]
        twin = LifecycleNode("grasp_server", context=other.context)
        other.executor.add_node(twin)
        assert "2 nodes are named /grasp_server" in looked_at(6, patience=SHORT)["server"][1]
        for node in (stranger, twin):
            other.executor.remove_node(node)
            node.destroy_node()


def test_what_the_server_says_of_itself(server: Client) -> None:
    assert not server.parameters(model="damaged")
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.error_code == ErrorCode.MODEL_NOT_LOADED
    try:
        level, text = looked_at(patience=SHORT)["health"]
        assert level == "fail" and "does not fit" in text
    finally:
        assert not server.parameters(model="quick")
    assert still_serves(server)


def test_no_cloud_where_the_server_looks(server: Client) -> None:
    assert "nobody publishes /points; start the camera" in looked_at(patience=5.0)["points"][1]
    elsewhere = server.node.create_publisher(PointCloud2, "camera/points", SENSOR)
    try:
        level, text = looked_at(patience=5.0)["points"]
        assert level == "fail" and "points:=/camera/points" in text
        # What the server listens to counts, and without one what is given.
        level, text = looked_at(points="camera/points", patience=5.0)["points"]
        assert level == "fail" and "nobody publishes /points" in text
        with GraspClient.open("doctor", domain_id=own_domain(1)) as client:
            nobody = Asked(client, "no_server", seconds=1.0, patience=SHORT)
            (line,) = InputChecks(nobody, "camera/points", {}, None).cloud()
        assert line.level == "fail" and "nothing came in 1 s" in line.text
    finally:
        in_executor(server.node, lambda: server.node.destroy_publisher(elsewhere))


def test_another_type_on_the_topic() -> None:
    with spinning_node(own_domain(6), "talker") as talker:
        talker.create_publisher(String, "points", 1)
        level, text = looked_at(6, patience=SHORT)["points"]
        assert level == "fail" and "carries std_msgs/msg/String" in text


def test_depth_images_and_their_camera() -> None:
    with (
        spinning_node(own_domain(6), "camera") as camera,
        GraspClient.open("doctor", domain_id=own_domain(6)) as client,
    ):
        asked = Asked(client, "grasp_server", seconds=1.0, patience=2.0)
        checks = InputChecks(asked, "points", {}, None)
        camera.create_publisher(Image, "depth", SENSOR)
        assert checks.images()[0].text.startswith("nobody publishes /camera_info;")
        camera.create_publisher(CameraInfo, "camera_info", SENSOR)
        assert until(lambda: "nothing came" in checks.images()[0].text, WAIT)


def test_depth_images_go_through_frame_and_gravity(server: Client) -> None:
    with set_to(server, {"input": "points"}, input="depth"), depth_camera(server):
        found = looked_at()
        assert found["images"][0] in ("ok", "warn"), found
        assert found["gravity"][0] == "fail" and "gravity: [0.0, 0.0, 1.0]" in found["gravity"][1]
        with set_to(server, {"gravity": [0.0] * 3}, gravity=[0.0, 0.0, 1.0]):
            assert looked_at()["view"][0] == "ok"


def test_topics_that_the_server_is_remapped_to() -> None:
    """It alone knows them; what comes on the plain name does not count."""
    told = {"topic points": "/dead", "topic depth": "/depth", "topic camera_info": "/gone"}
    status = DiagnosticStatus(
        name="/grasp_server",
        level=DiagnosticStatus.WARN,
        message="the changer reports franka_hand",
        values=[
            KeyValue(key=key, value=value)
            for key, value in (
                *told.items(), ("tool_id", "franka_hand"), ("active gripper", "robotiq_2f85")
            )
        ],
    )  # fmt: skip
    with (
        spinning_node(own_domain(6), "grasp_server") as server,
        GraspClient.open("doctor", domain_id=own_domain(6)) as client,
    ):
        publisher = server.create_publisher(DiagnosticArray, "/diagnostics", 1)
        server.create_publisher(PointCloud2, "points", SENSOR)
        server.create_timer(0.2, lambda: publisher.publish(DiagnosticArray(status=[status])))
        asked = Asked(client, "grasp_server", seconds=1.0, patience=SHORT)
        line, heard = health(asked)
        assert line.level == "fail" and "203" in line.text and "robotiq_2f85" in line.text
        checks = InputChecks(asked, "points", heard, None)
        assert "nobody publishes /dead" in checks.cloud()[0].text
        assert "nobody publishes /depth, /gone" in checks.images()[0].text
        assert cloud_topic(client.node, "grasp_server") == "/dead"


def test_slow_old_and_early_clouds(server: Client) -> None:
    with camera(server, table_points(500), rate=1.0):
        level, text = looked_at()["points"]
        assert level == "warn" and "cloud_timeout is 0.7 s" in text
    with camera(server, table_points(500), age=60.0):
        level, text = looked_at()["stamps"]
        assert level == "fail" and "cloud_max_age is 5 s" in text
    with camera(server, table_points(500), age=-60.0):
        level, text = looked_at()["stamps"]
        assert level == "fail" and "ahead of this machine's clock" in text


def test_a_clock_that_stands_still(server: Client) -> None:
    with set_to(server, {"use_sim_time": False}, use_sim_time=True):
        level, text = looked_at(patience=SHORT)["clock"]
    assert level == "fail" and "nobody publishes /clock" in text


@pytest.mark.parametrize(
    ("parameters", "frame", "scale", "what", "expected"),
    [
        ({}, "", 1.0, "frame", "frame_id is empty"),
        ({"planning_frame": "base"}, "cam", 1.0, "frame", "extrinsics: [x, y, z"),
        ({}, "camera_color_optical_frame", 1.0, "gravity", "gravity: [0.0, 0.0, 1.0]"),
        ({}, "world", 1000.0, "view", "expected metres"),
        ({}, "world", 1000.0, "view", "the driver publishes metres"),
        ({"gravity": [0.0, 0.0, 1.0]}, "world", 1.0, "view", "points down"),
        ({"gravity": [0.0, 0.0, 1.0], "sensor_origin": [0.0] * 3},
         "world", 1.0, "view", "sensor_origin is not set"),
        ({"sensor_origin": [0.0] * 3}, "world", 1.0, "view", "sensor_origin is not set"),
        ({"floor": [-12.0]}, "world", 1.0, "floor", "below the lowest points"),
        ({"region__size": [0.1, 0.1, 0.1], "region__pose": [5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]},
         "world", 1.0, "region", "no point lies in it"),
        ({"region__size": [0.02, 0.02, 0.02]}, "world", 1.0, "region", "only"),
    ],
)  # fmt: skip
def test_frames_gravity_units_region(
    server: Client, parameters: dict, frame: str, scale: float, what: str, expected: str
) -> None:
    before = {
        "planning_frame": "", "gravity": [0.0] * 3, "region__size": [0.0] * 3,
        "region__pose": [0.0] * 6 + [1.0], "sensor_origin": [0.0] * 3, "floor": [0.0] * 4,
    }  # fmt: skip
    with (
        set_to(server, before, **{"sensor_origin": ABOVE, **parameters}),
        camera(server, scale * table_points(), frame=frame),
    ):
        level, text = looked_at()[what]
    assert level == ("warn" if expected == "only" else "fail") and expected in text


def test_a_listener_that_misses_what_was_latched(server: Client) -> None:
    deaf = server.node.create_subscription(GraspArray, "grasps", lambda message: None, 1)
    try:
        found: FOUND = {}

        def noticed() -> bool:
            found.update(looked_at(patience=SHORT))
            return found.get("listeners", ("ok",))[0] == "warn"

        assert until(noticed, WAIT)
        assert "durability volatile" in found["listeners"][1]
    finally:
        in_executor(server.node, lambda: server.node.destroy_subscription(deaf))

"""The client for Python programs, against a running server."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rclpy
from cell_processes import WAIT, in_executor, own_domain, until
from megrasp_msgs.msg import ErrorCode, OrientedBox
from megrasp_msgs.srv import DetectBin
from sensor_msgs.msg import PointCloud2
from server_client import Client, camera, cloud_of, running_server, still_serves, table_points

from megrasp_core.grippers import load_gripper
from megrasp_core.storage import AttemptFolder, read_attempt
from megrasp_ros.client import GraspClient, GraspServerError


@contextmanager
def opened(offset: int = 1, **options):
    """A client that stands on its own feet."""
    with GraspClient.open(domain_id=own_domain(offset), **{"timeout": WAIT, **options}) as client:
        client.wait_until_ready(WAIT)
        yield client


def test_grasps_grippers_and_errors(server: Client) -> None:
    client = GraspClient(server.node)
    assert {"robotiq_2f85", "franka_hand"} <= set(client.grippers())
    assert client.set_gripper("franka_hand").name == "franka_hand"
    answer = client.synthesize(num_grasps=3, cloud=cloud_of(server), seed=4)
    assert len(answer.grasps.grasps) == 3
    assert (answer.grasps.gripper, answer.grasps.seed) == ("franka_hand", 4)
    with pytest.raises(GraspServerError, match="unknown gripper 'vacuum'") as error:
        client.set_gripper("vacuum")
    assert error.value.code == ErrorCode.UNKNOWN_GRIPPER
    with pytest.raises(GraspServerError) as error:
        client.synthesize(num_grasps=0)
    assert error.value.code == ErrorCode.INVALID_REQUEST
    assert error.value.answer.error_code == ErrorCode.INVALID_REQUEST
    assert "robotiq_2f85" in client.reload_grippers().available


def test_a_server_that_is_not_there_is_told(server: Client) -> None:
    client = GraspClient(server.node, namespace="elsewhere", timeout=0.3)
    with pytest.raises(GraspServerError, match=r"elsewhere/list_grippers.*0\.3 s") as error:
        client.grippers()
    assert error.value.code == 0 and error.value.answer is None
    with pytest.raises(GraspServerError, match=r"elsewhere/synthesize_grasps \(grasp_server\)"):
        client.wait_until_ready(0.3)
    with pytest.raises(GraspServerError, match=r"action .*generate_grasps is not there"):
        client.generate(3)


def test_waiting_for_a_server_leaves_its_log_alone(tmp_path: Path) -> None:
    """It is asked for its state; where it cannot be configured, the reason is raised."""
    with running_server(7, tmp_path, model="late", autostart=False) as (_, processes):
        with GraspClient.open(domain_id=own_domain(7), timeout=WAIT) as client:
            with pytest.raises(GraspServerError) as error:
                client.wait_until_ready(4.0)
            assert error.value.code == ErrorCode.NOT_ACTIVE
        before = processes.log("grasp_server").count("WARN")
        assert before <= 2, "one answer at the end, not one for each look"


def test_a_server_that_cannot_be_configured_is_told(tmp_path: Path) -> None:
    with (
        running_server(7, tmp_path, model="damaged") as _,
        GraspClient.open(domain_id=own_domain(7), timeout=WAIT) as client,
    ):
        with pytest.raises(GraspServerError, match="configuring it failed") as error:
            client.wait_until_ready(WAIT)
        assert error.value.code == ErrorCode.MODEL_NOT_LOADED


def test_a_node_that_nobody_spins_is_told() -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain(1))
    node = rclpy.create_node("still", context=context)
    try:
        with pytest.raises(GraspServerError, match="nothing spins the node /still"):
            GraspClient(node).grippers()
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_ctrl_c_amid_a_new_subscription_stays_a_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    """It leaves rclpy without entries that it removes when the node goes."""

    def interrupted() -> None:
        raise KeyboardInterrupt

    with (
        pytest.raises(KeyboardInterrupt),
        GraspClient.open(domain_id=own_domain(1)) as client,
        monkeypatch.context() as once,
    ):
        once.setattr(client.node, "_wake_executor", interrupted)
        client.node.create_subscription(PointCloud2, "/silent", print, 1)


def test_it_can_bring_its_own_node_or_use_a_context(server: Client) -> None:
    with opened() as client:
        assert client.state() == "active"
        found = client.parameters(["gripper", "gravity", "no_such_parameter"])
        assert found["gripper"] == "robotiq_2f85" and len(found["gravity"]) == 3
        assert "no_such_parameter" not in found
    with GraspClient.open("guest", context=server.node.context, timeout=WAIT) as client:
        assert client.node.get_name() == "guest"
        assert client.state() == "active"
    assert server.node.context.ok()


def test_the_action_tells_its_steps_and_unfinished_grasps(server: Client) -> None:
    heard: list = []
    with opened() as client:
        result = client.generate(3, cloud=cloud_of(server), on_feedback=heard.append, seed=5)
        assert len(result.grasps.grasps) == 3 and result.grasps.seed == 5
        assert until(lambda: any(each.phase == "check" for each in heard))
        assert any(each.grasps.grasps for each in heard if each.phase == "sample")
        with pytest.raises(GraspServerError, match="num_grasps is 0") as error:
            client.generate(0)
        assert error.value.code == ErrorCode.INVALID_REQUEST


def test_the_action_is_cancelled(server: Client) -> None:
    assert not server.parameters(model="slow")
    sampling = threading.Event()
    with opened() as client:
        result = client.generate(
            3,
            cloud=cloud_of(server),
            on_feedback=lambda f: f.phase == "sample" and sampling.set(),
            cancelled=sampling.is_set,
        )
        assert result.error_code == ErrorCode.CANCELLED
        assert [grasp.collision_free for grasp in result.grasps.grasps] == [False]
    assert not server.parameters(model="quick")
    assert still_serves(server)


def test_what_fails_while_listening_ends_the_goal_too(server: Client) -> None:
    """The server must not go on working for nobody."""
    assert not server.parameters(model="slow")

    def broken(feedback: object) -> None:
        raise KeyError("a mistake in the caller's code")

    with opened() as client:
        start = time.monotonic()
        with pytest.raises(KeyError, match="a mistake"):
            client.generate(3, cloud=cloud_of(server), on_feedback=broken)
        assert not server.parameters(model="quick")
        assert until(lambda: still_serves(server), 30.0)
        assert client.state() == "active"
        assert time.monotonic() - start < WAIT


def test_a_goal_that_takes_too_long_is_given_up(server: Client) -> None:
    assert not server.parameters(model="slow")
    silent = pytest.raises(GraspServerError, match="did not answer within 1 s")
    with opened(timeout=1.0) as client, silent:
        client.generate(3, cloud=cloud_of(server), timeout=30.0)
    assert not server.parameters(model="quick")
    assert until(lambda: still_serves(server), 30.0)


def test_many_threads_lose_no_answer(server: Client) -> None:
    """What rclpy's own call_async from other threads does lose now and then."""
    answers: list[int] = []
    with opened() as client:

        def ask() -> None:
            for _ in range(10):
                answers.append(len(client.grippers()))

        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(WAIT)
    assert len(answers) == 80 and min(answers) > 2


def test_latched_topics_are_heard(server: Client) -> None:
    with opened() as client:
        assert until(lambda: client.active_gripper is not None)
        assert client.active_gripper is not None
        assert client.active_gripper.name == "robotiq_2f85"
        before = client.grasps
        client.synthesize(4, cloud=cloud_of(server))
        grasps = client.wait_for_grasps(WAIT, after=before)
        assert len(grasps.grasps) == 4
        with pytest.raises(GraspServerError, match=r"no grasps were published within 0\.2 s"):
            client.wait_for_grasps(0.2, after=grasps)
        client.set_gripper("franka_hand")
        assert until(lambda: client.grasps is not None and not client.grasps.grasps)
        assert until(lambda: client.active_gripper.name == "franka_hand")


def test_the_bin_is_asked_for(server: Client) -> None:
    asked: list[DetectBin.Request] = []

    def answer(request: DetectBin.Request, response: DetectBin.Response) -> DetectBin.Response:
        asked.append(request)
        response.success, response.fill_level = True, 0.5
        response.bin.size.x = request.size.x
        return response

    service = server.node.create_service(DetectBin, "test/detect_bin", answer)
    try:
        with opened() as client:
            asking = GraspClient(client.node, namespace="/test", timeout=WAIT)
            found = asking.detect_bin((0.4, 0.3, 0.15))
    finally:
        in_executor(server.node, lambda: server.node.destroy_service(service))
    assert found.bin.size.x == 0.4 and found.fill_level == 0.5
    assert asked[0].cloud.width == 0


def test_the_newest_cloud_and_its_absence(server: Client) -> None:
    with opened() as client:
        with pytest.raises(GraspServerError, match=r"no cloud came on /points within 0\.2 s"):
            client.newest_cloud(0.2)
        with camera(server, table_points(200)):
            first = client.newest_cloud(WAIT)
            later = client.newest_cloud(WAIT, after=first.header.stamp)
        stamps = [(c.header.stamp.sec, c.header.stamp.nanosec) for c in (first, later)]
        assert stamps[0] < stamps[1]
        with pytest.raises(GraspServerError, match="no cloud that is new enough"):
            client.newest_cloud(0.2, after=client.node.get_clock().now().to_msg())


def test_an_attempt_is_recorded_with_all_that_the_server_knew(server: Client, tmp_path) -> None:
    """In the planning frame, with the region of the request, and the gravity of the server."""
    up_side = [0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]
    assert not server.parameters(planning_frame="base", extrinsics=up_side)
    region = OrientedBox()
    region.pose.orientation.w = 1.0
    region.pose.position.z = 0.45
    region.size.x, region.size.y, region.size.z = 0.4, 0.3, 0.3
    points = table_points() * [1, -1, -1] + [0, 0, 0.5]
    with opened(record=AttemptFolder(tmp_path, limit=10**8)) as client:
        with camera(server, points, frame="cam"):
            answer = client.synthesize(3, region=region, seed=9)
        grasps = answer.grasps
        path = client.record(grasps, grasps.grasps[1], success=False, reason="slipped", bin=4)
        assert path is not None
        other = client.synthesize(3, cloud=cloud_of(server, points, "cam"))
        assert client.record(grasps, grasps.grasps[0], success=True) is None, "an older answer"
        assert client.record(other.grasps, other.grasps.grasps[0], success=True) is not None
    attempt = read_attempt(path)
    assert attempt.frame == "base" and (attempt.rank, attempt.seed) == (1, 9)
    assert (attempt.success, attempt.reason, attempt.extra) == (False, "slipped", {"bin": 4})
    assert attempt.gripper_hash == load_gripper("robotiq_2f85").hash
    assert attempt.model == grasps.model_id
    assert np.allclose(attempt.gravity, (0, 0, -1))
    assert np.allclose(attempt.sensor, (0, 0, 0.5))
    assert attempt.region is not None and np.allclose(attempt.region.size, (0.4, 0.3, 0.3))
    assert np.abs(attempt.points[:, 2]).max() < 0.07, "the table is at z = 0 of the base"
    tcp = grasps.grasps[1].tcp.position
    assert np.allclose(attempt.world_from_tcp[:3, 3], (tcp.x, tcp.y, tcp.z))
    assert np.linalg.norm(attempt.points - attempt.world_from_tcp[:3, 3], axis=1).min() < 0.02


def test_a_disk_that_takes_nothing_does_not_stop_the_cell(server: Client, tmp_path) -> None:
    (tmp_path / "file").write_text("no folder")
    with opened(record=tmp_path / "file" / "attempts") as client:
        answer = client.synthesize(2, cloud=cloud_of(server))
        assert client.record(answer.grasps, answer.grasps.grasps[0], success=True) is None
    with opened() as client, pytest.raises(ValueError, match="record=FOLDER"):
        client.record(answer.grasps, answer.grasps.grasps[0], success=True)

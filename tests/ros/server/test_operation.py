"""How the node is run: beside others, in simulated time, while it loads, after it was killed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from builtin_interfaces.msg import Time
from cell_processes import own_domain, until
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ListGrippers, SetGripper, SynthesizeGrasps
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from server_client import DOUBLE, table_points
from server_double import make

from megrasp_core.pointcloud import Cloud, write_cloud
from megrasp_ros.cloud_replay import CloudReplay
from megrasp_ros.qos import LATCHED, SENSOR
from megrasp_ros.sensor_messages import cloud_message
from megrasp_ros.server.grasp_server import GraspServer
from megrasp_ros.tool_changer import ToolChanger
from megrasp_ros.trials.malformed import trial
from megrasp_ros.trials.server_process import (
    ServerProcess,
    executable,
    server_process,
    start_node,
    stop,
)

COMMAND = [sys.executable, str(DOUBLE)]
QUICK = {"model": "quick", "device": "cpu"}


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain(5)))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))


def synthesis(server: ServerProcess, **fields):
    request = SynthesizeGrasps.Request(num_grasps=3, **fields)
    return server.call(request)


def test_the_node_is_there_before_anything_heavy_is_imported() -> None:
    heavy = ("torch", "scipy", "mujoco", "trimesh")
    code = f"""
import sys
import megrasp_ros.server.grasp_server
print([name for name in {heavy} if name in sys.modules])
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert told.stdout.strip() == "[]", told.stderr


def test_requests_are_refused_while_the_model_loads() -> None:
    with server_process({**QUICK, "model": "late"}, command=COMMAND) as server:
        for request in (SynthesizeGrasps.Request(num_grasps=1), SetGripper.Request()):
            answer = server.call(request)
            assert answer.error_code == ErrorCode.NOT_ACTIVE, answer.error_msg
        server.wait_until_active()


def test_two_servers_in_two_namespaces_do_not_mind_each_other() -> None:
    with (
        server_process(QUICK, command=COMMAND, namespace="/left") as left,
        server_process(
            {**QUICK, "gripper": "franka_hand"}, command=COMMAND, namespace="/cell/right"
        ) as right,
    ):
        left.wait_until_active()
        right.wait_until_active()
        heard: dict[str, list[PoseArray]] = {"left": [], "right": []}
        for name, server in (("left", left), ("right", right)):
            server.node.create_subscription(PoseArray, "pregrasps", heard[name].append, LATCHED)
        assert left.call(SetGripper.Request(gripper_name="robotiq_3f")).success
        assert right.call(ListGrippers.Request()).active == "franka_hand"
        stamp = left.node.get_clock().now().to_msg()
        cloud = cloud_message(table_points(), frame="world", stamp=stamp)
        answer = synthesis(left, cloud=cloud)
        assert answer.grasps.gripper == "robotiq_3f"
        assert until(lambda: bool(heard["left"]) and len(heard["left"][-1].poses) == 3)
        assert not any(message.poses for message in heard["right"])
        assert synthesis(right, cloud=cloud).grasps.gripper == "franka_hand"


def test_time_may_come_from_a_clock() -> None:
    parameters = {**QUICK, "use_sim_time": True, "cloud_max_age": 2.0, "cloud_timeout": 1.0}
    with server_process(parameters, command=COMMAND) as server:
        server.wait_until_active()
        clock = server.node.create_publisher(Clock, "/clock", 10)
        points = server.node.create_publisher(PointCloud2, "points", SENSOR)
        now = [100]

        def publish() -> None:
            clock.publish(Clock(clock=Time(sec=now[0])))
            points.publish(
                cloud_message(table_points(), frame="world", stamp=Time(sec=100, nanosec=5))
            )

        server.node.create_timer(0.05, publish)
        assert until(lambda: synthesis(server).success)
        assert synthesis(server).grasps.header.stamp == Time(sec=100, nanosec=5)
        # A minute passes in the simulation while the camera shows the same picture.
        now[0] = 160
        assert until(lambda: synthesis(server).error_code == ErrorCode.STALE_CLOUD)


def test_a_replayed_cloud_and_a_seed_give_the_same_grasps(tmp_path: Path) -> None:
    file = tmp_path / "table.ply"
    write_cloud(file, Cloud(table_points()))
    with server_process(QUICK, command=COMMAND) as server:
        server.wait_until_active()
        camera = start_node(
            [str(executable("cloud_replay"))],
            server.node.get_namespace(),
            {"file": str(file), "rate": 10.0, "frame_id": "table"},
            tmp_path / "cloud_replay.log",
        )
        try:
            assert until(lambda: synthesis(server).success)
            first, again, other = (synthesis(server, seed=seed) for seed in (3, 3, 4))
        finally:
            assert stop(camera) == 0
        assert first.grasps.header.frame_id == "table"
        assert first.grasps.header.stamp != again.grasps.header.stamp
        assert first.grasps.grasps == again.grasps.grasps != other.grasps.grasps


def test_a_server_that_was_killed_is_back_when_it_is_started_again() -> None:
    with server_process(QUICK, command=COMMAND, namespace="/cell") as first:
        first.wait_until_active()
        first.process.send_signal(signal.SIGKILL)
        assert first.process.wait(30.0) == -signal.SIGKILL
        with server_process(QUICK, command=COMMAND, namespace="/cell") as second:
            second.wait_until_active()
            # The program that knew the first one need not be started again.
            request = SetGripper.Request(gripper_name="franka_hand")
            assert until(lambda: getattr(first.call(request, 5.0), "success", False))


@pytest.mark.slow
def test_three_hundred_malformed_requests_are_answered() -> None:
    with server_process({}, command=COMMAND) as server:
        record = trial(server, 300, seed=7)
    assert (record["requests"], record["serves_afterwards"]) == (300, True)
    assert not record["unanswered"]
    assert not record["internal_errors"]
    assert len(record["answers"]) > 5


@pytest.fixture
def own_context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain(6))
    yield context
    context.try_shutdown()


def test_nodes_are_made_like_any_others(own_context: rclpy.Context, tmp_path: Path) -> None:
    """Several in one process, named, with parameters, in a context of their own."""
    file = tmp_path / "table.ply"
    write_cloud(file, Cloud(table_points()))
    assert not rclpy.ok()
    where = {"namespace": "/cell", "context": own_context}
    servers = [
        GraspServer(
            name,
            factory=make,
            parameter_overrides=[
                Parameter("gripper", value=gripper),
                Parameter("autostart", value=False),
            ],
            cli_args=["--ros-args", "-r", f"synthesize_grasps:={name}/synthesize_grasps"],
            **where,
        )
        for name, gripper in (("coarse", "robotiq_2f85"), ("fine", "franka_hand"))
    ]
    others: list[Node] = [
        ToolChanger("changer", parameter_overrides=[Parameter("mounted", value="hook")], **where),
        CloudReplay("replay", parameter_overrides=[Parameter("file", value=str(file))], **where),
    ]
    executor = SingleThreadedExecutor(context=own_context)
    for node in [*servers, *others]:
        executor.add_node(node)
    names = {node.get_fully_qualified_name() for node in executor.get_nodes()}
    assert names == {"/cell/coarse", "/cell/fine", "/cell/changer", "/cell/replay"}
    services = {service.service_name for server in servers for service in server.services}
    assert {"/cell/coarse/synthesize_grasps", "/cell/fine/synthesize_grasps"} <= services
    assert [node.get_parameter("gripper").value for node in servers] == [
        "robotiq_2f85",
        "franka_hand",
    ]
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    for server in servers:
        server.close()
    executor.shutdown()
    for node in [*servers, *others]:
        node.destroy_node()
    assert not rclpy.ok()

"""A grasp_server process and a client of it, for the tests; real processes over Fast DDS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from cell_processes import (
    WAIT,
    Processes,
    in_executor,
    own_domain,
    processes,
    result,
    spinning_node,
    until,
)
from geometry_msgs.msg import PoseArray
from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode, GraspArray, GripperInfo
from megrasp_msgs.srv import ListGrippers, ReloadGrippers, SetGripper, SynthesizeGrasps
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2

from megrasp_ros.qos import LATCHED, SENSOR
from megrasp_ros.sensor_messages import cloud_message

DOUBLE = Path(__file__).parent / "server_double.py"
GRIPPERS = ("robotiq_2f85", "robotiq_3f")
START = 240.0
"""A node imports torch before anything else, which takes half a minute on a busy machine."""


MOUNTED = "flange_from_gripper__robotiq_2f85"
MOUNTING = [0.0, 0.0, 0.012, 0.0, 0.0, 0.38268343, 0.92387953]
"""Where the server is told that the gripper is on the flange: as docs/frames.md has it."""


class Client:
    """Blocking calls of a running grasp_server."""

    def __init__(self, node: Node, running: Processes) -> None:
        self.node = node
        process = running.running["grasp_server"]
        self._services = {
            kind: node.create_client(kind, name)
            for kind, name in (
                (SynthesizeGrasps, "synthesize_grasps"),
                (SetGripper, "set_gripper"),
                (ListGrippers, "list_grippers"),
                (ReloadGrippers, "reload_grippers"),
                (SetParameters, "grasp_server/set_parameters"),
            )
        }
        self.action = ActionClient(node, GenerateGrasps, "generate_grasps")
        end = time.monotonic() + START
        waits = [client.wait_for_service for client in self._services.values()]
        for wait in (*waits, self.action.wait_for_server):
            while not wait(timeout_sec=1.0):
                assert process.poll() is None, running.log("grasp_server")
                assert time.monotonic() < end, "the node did not offer all its services"

    def wait_until_started(self) -> None:
        """Wait until a node that starts by itself is active, or has failed to be configured."""

        def started() -> bool:
            answer = self.set_gripper("robotiq_2f85", dry_run=True)
            return answer.error_code != ErrorCode.NOT_ACTIVE

        assert until(started, START), "the node did not become active"

    def start(self, request) -> Future:
        """Send a service request and return its future."""
        kind = next(kind for kind in self._services if isinstance(request, kind.Request))
        return in_executor(self.node, lambda: self._services[kind].call_async(request))

    def call(self, request, seconds: float = WAIT):
        """Send a service request and return the answer."""
        return result(self.start(request), seconds)

    def synthesize(self, **fields):
        """Call synthesize_grasps."""
        return self.call(SynthesizeGrasps.Request(**fields))

    def set_gripper(self, name: str, *, dry_run: bool = False):
        """Call set_gripper."""
        return self.call(SetGripper.Request(gripper_name=name, dry_run=dry_run))

    def parameters(self, **values) -> list[str]:
        """Set parameters of the server (`__` stands for a dot); return the reasons of refusals."""
        messages = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        answer = self.call(SetParameters.Request(parameters=messages))
        return [each.reason for each in answer.results if not each.successful]

    def goal(self, *, feedback=None, **fields) -> ClientGoalHandle:
        """Send an action goal; return its handle once it is accepted."""
        goal = GenerateGrasps.Goal(**fields)
        handle = result(
            in_executor(
                self.node, lambda: self.action.send_goal_async(goal, feedback_callback=feedback)
            )
        )
        assert handle.accepted
        return handle

    def outcome(self, handle: ClientGoalHandle) -> Future:
        """Ask for the result of a goal and return its future."""
        return in_executor(self.node, handle.get_result_async)

    def cancel(self, handle: ClientGoalHandle) -> None:
        """Ask for a goal to be cancelled."""
        in_executor(self.node, handle.cancel_goal_async)


@contextmanager
def running_server(
    offset: int, folder: Path, *, double: bool = True, **parameters: object
) -> Iterator[tuple[Client, Processes]]:
    """Yield a client of a fresh grasp_server process; `double` puts the test double into it."""
    with (
        processes(own_domain(offset), folder) as running,
        spinning_node(own_domain(offset)) as node,
    ):
        if double:
            running.start_command("grasp_server", [sys.executable, str(DOUBLE)], **parameters)
        else:
            running.start("grasp_server", **parameters)
        client = Client(node, running)
        if parameters.get("autostart", True):
            client.wait_until_started()
        yield client, running


def table_points(count: int = 4000, *, objects: bool = True, seed: int = 0) -> np.ndarray:
    """Return points (count, 3) of a table at z = 0 with a block of 4 x 4 x 6 cm at x = 0.05, seen
    from above.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0), (count, 3))
    block = (np.abs(points[:, 0] - 0.05) < 0.02) & (np.abs(points[:, 1]) < 0.02)
    if objects:
        points[block, 2] = 0.06
        top = rng.uniform((0.03, -0.02, 0.06), (0.07, 0.02, 0.06), (count // 8, 3))
        points = np.concatenate([points, top])
    points[:, 2] += rng.normal(0.0, 0.0005, len(points))
    return points


def stamped_cloud(
    node: Node, points: np.ndarray, frame: str = "world", age: float = 0.0
) -> PointCloud2:
    """Return a cloud with the stamp `age` seconds ago."""
    now = node.get_clock().now().nanoseconds - round(age * 1e9)
    message = cloud_message(points, frame=frame, stamp=node.get_clock().now().to_msg())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
    return message


@contextmanager
def camera(
    client: Client,
    points: np.ndarray,
    *,
    frame: str = "world",
    age: float = 0.0,
    rate: float = 10.0,
):
    """Publish a cloud on `points` while the context lasts, each with a stamp `age` seconds ago."""
    publisher = client.node.create_publisher(PointCloud2, "points", SENSOR)
    stop = threading.Event()

    def publish() -> None:
        while not stop.wait(1.0 / rate):
            publisher.publish(stamped_cloud(client.node, points, frame, age))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield publisher
    finally:
        stop.set()
        thread.join()
        in_executor(client.node, lambda: client.node.destroy_publisher(publisher))


def seconds_since(start: float) -> float:
    """Return the time since a value of time.monotonic()."""
    return time.monotonic() - start


POINTS = table_points()
LATCHED_TOPICS = {
    "pregrasps": PoseArray,
    "approach_poses": PoseArray,
    "grasps": GraspArray,
    "active_gripper": GripperInfo,
}


def cloud_of(client: Client, points: np.ndarray = POINTS, frame: str = "world") -> PointCloud2:
    """Return a cloud with the stamp of now."""
    return stamped_cloud(client.node, points, frame)


def still_serves(client: Client) -> bool:
    """Return whether a plain request is answered with grasps."""
    answer = client.synthesize(num_grasps=2, cloud=cloud_of(client))
    return answer.success and len(answer.grasps.grasps) == 2


class Latest:
    """The messages of a latched topic."""

    def __init__(self, client: Client, kind: type, topic: str) -> None:
        self.messages: list = []
        self.node = client.node
        self.subscription = client.node.create_subscription(
            kind, topic, self.messages.append, LATCHED
        )

    def close(self) -> None:
        """Look no longer."""
        self.node.destroy_subscription(self.subscription)

    @property
    def last(self):
        """The newest message."""
        return self.messages[-1]

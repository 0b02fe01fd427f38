"""The services, action and topic that empty a bin, as blocking calls with timeouts.

Everything goes through the public interface, so the same client works on a real cell that offers
`points`, `change_tool` and `execute_grasp`. Another thread must spin the node,
with a single-threaded executor.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from builtin_interfaces.msg import Time as TimeMessage
from megrasp_msgs.action import ExecuteGrasp
from megrasp_msgs.msg import Grasp
from megrasp_msgs.srv import ChangeTool
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from megrasp_ros.client import GraspClient, GraspServerError
from megrasp_ros.qos import SENSOR
from megrasp_ros.waiting import send_in_executor

CLOUDS_KEPT = 4


class SystemFailure(Exception):
    """A part of the system is missing, silent, or refuses what it must be able to do."""


class ClearingClient(GraspClient):
    """Calls of `bin_clearing`: those of the grasp server and those of the cell.

    Each raises SystemFailure naming the part that does not answer.
    """

    def __init__(self, node: Node, *, timeout: float) -> None:
        """timeout: longest wait for one answer (s), for a synthesis on a slow machine included."""
        super().__init__(node, timeout=timeout)
        self._change_tool = node.create_client(ChangeTool, "change_tool")
        self._execute = ActionClient(node, ExecuteGrasp, "execute_grasp")
        self._clouds: deque[PointCloud2] = deque(maxlen=CLOUDS_KEPT)
        self._clouds_lock = threading.Lock()
        node.create_subscription(PointCloud2, "points", self._keep_cloud, SENSOR)

    def wait_until_ready(self, timeout: float) -> None:
        """Waits for every service and the action, `timeout` seconds in all."""
        end = self._node.get_clock().now().nanoseconds * 1e-9 + timeout
        parts: list[tuple[str, Any]] = [
            (f"service {client.srv_name} (grasp_server)", client.wait_for_service)
            for client in (self._synthesize, self._set_gripper)
        ]
        parts.append(
            (
                f"service {self._change_tool.srv_name} (sim_cell)",
                self._change_tool.wait_for_service,
            )
        )
        parts.append(("action execute_grasp (sim_cell)", self._execute.wait_for_server))
        for what, wait in parts:
            left = max(0.01, end - self._node.get_clock().now().nanoseconds * 1e-9)
            if wait(timeout_sec=left):
                continue
            # A wait also ends, without success, when the process is told to end.
            if not self._node.context.ok():
                raise ExternalShutdownException
            raise SystemFailure(
                f"{what} is not there after {timeout:g} s; start the node that offers it in the "
                "same namespace and ROS_DOMAIN_ID"
            )

    def change_tool(self, name: str) -> ChangeTool.Response:
        """Calls `change_tool`."""
        return self._call(self._change_tool, ChangeTool.Request(gripper_name=name))

    def execute(self, header: Header, gripper: str, grasp: Grasp) -> ExecuteGrasp.Result:
        """Sends one goal to `execute_grasp` and waits for its result."""
        goal = ExecuteGrasp.Goal(header=header, gripper=gripper, grasp=grasp)
        handle = send_in_executor(
            self._node, lambda: self._execute.send_goal_async(goal), self._timeout
        )
        if handle is None:
            raise SystemFailure(f"execute_grasp did not take the goal within {self._timeout:g} s")
        if not handle.accepted:
            raise SystemFailure("execute_grasp rejected the goal without a reason")
        answer = send_in_executor(self._node, handle.get_result_async, self._timeout)
        if answer is None:
            raise SystemFailure(f"execute_grasp gave no result within {self._timeout:g} s")
        return answer.result

    def cloud_of(self, stamp: TimeMessage) -> PointCloud2 | None:
        """The cloud with this stamp, else the newest one that arrived, else None."""
        with self._clouds_lock:
            clouds = list(self._clouds)
        for cloud in clouds:
            if cloud.header.stamp == stamp:
                return cloud
        return clouds[-1] if clouds else None

    def _keep_cloud(self, message: PointCloud2) -> None:
        with self._clouds_lock:
            self._clouds.append(message)

    def _call(self, client: Client, request: Any) -> Any:
        try:
            return super()._call(client, request)
        except GraspServerError as error:
            if error.code:
                raise
            raise SystemFailure(str(error)) from error

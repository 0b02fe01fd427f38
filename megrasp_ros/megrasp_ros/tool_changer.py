"""Node between `change_tool` and a real tool changer: passes calls on, reports the mounted tool.

Backends:

* ``none``: there is no changer. Somebody changes the tool by hand and then calls `change_tool`.
* ``service``: the call goes on to another `megrasp_msgs/ChangeTool` service (parameter
  `service`), the driver of the changer; what that answers as `mounted` is published.

Either way `tool_id` (latched) carries the identity of the mounted tool, which `grasp_server`
compares with its active gripper (error 203).
"""

from __future__ import annotations

from typing import Any

from megrasp_msgs.srv import ChangeTool
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String

from megrasp_core.errors import InvalidRequestError

from .declaring import declare_once
from .process import StopSignals, run_node
from .qos import LATCHED
from .waiting import wait_for_future

BACKENDS = ("none", "service")


class ToolChanger(Node):
    """Serves `change_tool`, publishes `tool_id`."""

    def __init__(self, name: str = "tool_changer", **options: Any) -> None:
        """Make the node; `options` are those of rclpy's Node: namespace, context and so on."""
        super().__init__(name, **options)
        backend = self.declare_parameter(
            "backend",
            "none",
            ParameterDescriptor(description=f"one of {', '.join(BACKENDS)}", read_only=True),
        ).value
        target = declare_once(
            self,
            "service",
            "changer/change_tool",
            "the driver's ChangeTool service (backend `service`)",
        )
        mounted = declare_once(
            self, "mounted", "", "tool that is mounted at the start; empty: none"
        )
        self.declare_parameter(
            "timeout",
            60.0,
            ParameterDescriptor(
                description="longest wait for the driver (s)",
                floating_point_range=[FloatingPointRange(from_value=0.1, to_value=3600.0)],
            ),
        )
        if backend not in BACKENDS:
            raise InvalidRequestError(
                f"backend {backend!r} was given; expected one of {', '.join(BACKENDS)}"
            )
        group = ReentrantCallbackGroup()
        self._driver = (
            self.create_client(ChangeTool, target, callback_group=group)
            if backend == "service"
            else None
        )
        self._tool_id = self.create_publisher(String, "tool_id", LATCHED)
        self._mounted = mounted
        self._tool_id.publish(String(data=mounted))
        self.create_service(ChangeTool, "change_tool", self._change, callback_group=group)

    def _change(
        self, request: ChangeTool.Request, response: ChangeTool.Response
    ) -> ChangeTool.Response:
        if not request.gripper_name:
            response.message = "gripper_name is empty; expected the name of the tool to mount"
        elif self._driver is None:
            response.success, self._mounted = True, request.gripper_name
        else:
            self._ask_driver(request, response)
        response.mounted = self._mounted
        self._tool_id.publish(String(data=self._mounted))
        return response

    def _ask_driver(self, request: ChangeTool.Request, response: ChangeTool.Response) -> None:
        assert self._driver is not None
        name = self._driver.srv_name
        timeout: float = self.get_parameter("timeout").get_parameter_value().double_value
        if not self._driver.wait_for_service(timeout_sec=timeout):
            response.message = (
                f"no service {name} after {timeout:g} s; start the changer's driver or set the "
                "parameter `service`"
            )
            return
        answer = wait_for_future(self._driver.call_async(request), timeout, context=self.context)
        if answer is None:
            response.message = (
                f"{name} did not answer within {timeout:g} s; check the changer, then call again"
            )
            return
        response.success, response.message = answer.success, answer.message
        self._mounted = answer.mounted


def main(signals: StopSignals | None = None) -> None:
    """Entry point of the executable `tool_changer`."""
    run_node(ToolChanger, signals=signals)

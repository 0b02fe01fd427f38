"""The grasp server from a Python program, as blocking calls.

For example::

    node = rclpy.create_node("my_cell")
    client = GraspClient(node)              # another thread spins the node
    client.set_gripper("franka_hand")
    for grasp in client.synthesize(num_grasps=20).grasps.grasps:
        ...
"""

from __future__ import annotations

from typing import Any

from megrasp_msgs.msg import GripperInfo
from megrasp_msgs.srv import ListGrippers, SetGripper, SynthesizeGrasps
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node

from .waiting import wait_for_future


class GraspServerError(Exception):
    """The server answered with an error.

    Attributes:
        code: a constant of megrasp_msgs/msg/ErrorCode; 0: no answer.
        answer: the whole answer, None without one.
    """

    def __init__(self, code: int, message: str, answer: Any = None) -> None:
        super().__init__(f"error {code}: {message}" if code else message)
        self.code, self.answer = code, answer


class GraspClient:
    """Calls of a grasp_server. A thread other than the caller's must spin the node.

    Every method raises GraspServerError.
    """

    def __init__(self, node: Node, *, timeout: float = 60.0) -> None:
        """Make the clients.

        Args:
            node: that another thread spins.
            timeout: longest wait (s) for a service to appear and for its answer.
        """
        self._node, self._timeout = node, timeout
        group = ReentrantCallbackGroup()
        self._synthesize = node.create_client(
            SynthesizeGrasps, "synthesize_grasps", callback_group=group
        )
        self._set_gripper = node.create_client(SetGripper, "set_gripper", callback_group=group)
        self._list_grippers = node.create_client(
            ListGrippers, "list_grippers", callback_group=group
        )

    def synthesize(self, num_grasps: int = 20, **fields: Any) -> SynthesizeGrasps.Response:
        """Grasps, best first, with what was rejected and the times.

        Args:
            num_grasps: most to return.
            fields: further fields of SynthesizeGrasps.srv by their names.
        """
        # The server's own timeout would otherwise end a slow machine's synthesis earlier.
        request = {"timeout": 0.9 * self._timeout, **fields}
        return self._call(
            self._synthesize, SynthesizeGrasps.Request(num_grasps=num_grasps, **request)
        )

    def set_gripper(self, name: str, *, dry_run: bool = False) -> GripperInfo:
        """Make a gripper the active one, or only check that it could be."""
        request = SetGripper.Request(gripper_name=name, dry_run=dry_run)
        return self._call(self._set_gripper, request).gripper

    def grippers(self) -> dict[str, GripperInfo]:
        """Name -> description of the registered grippers."""
        answer = self._call(self._list_grippers, ListGrippers.Request())
        return {info.name: info for info in answer.grippers}

    def _call(self, client: Client, request: Any) -> Any:
        if not client.wait_for_service(timeout_sec=self._timeout):
            raise GraspServerError(
                0,
                f"no service {client.srv_name} after {self._timeout:g} s; start the node that "
                "offers it",
            )
        future = client.call_async(request)
        answer = wait_for_future(future, self._timeout, context=self._node.context)
        if answer is None:
            raise GraspServerError(
                0,
                f"service {client.srv_name} did not answer within {self._timeout:g} s; look at "
                "the log of the node that offers it",
            )
        if getattr(answer, "error_code", 0):
            raise GraspServerError(answer.error_code, answer.error_msg, answer)
        return answer

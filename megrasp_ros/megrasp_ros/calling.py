"""Services and actions as blocking calls, and the newest message of a topic with large ones."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from builtin_interfaces.msg import Time as TimeMessage
from megrasp_msgs.msg import ErrorCode
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from .qos import SENSOR
from .waiting import send_in_executor

T = TypeVar("T")

SLICE = 0.05
"""A topic is looked at so often (s) while its message is waited for."""


class GraspServerError(Exception):
    """The server answered with an error, or not at all.

    Attributes:
        code: a constant of megrasp_msgs/msg/ErrorCode; 0: no answer.
        answer: the whole answer, None without one.
    """

    def __init__(self, code: int, message: str, answer: Any = None) -> None:
        super().__init__(f"error {code}: {message}" if code else message)
        self.code, self.answer = code, answer


class Caller:
    """Makes clients when they are first used, and calls through the node's executor.

    Args:
        node: that another thread spins.
        prefix: put before every name.
        timeout: longest wait (s) for a service to appear, and for an answer.
    """

    def __init__(self, node: Node, prefix: str, timeout: float) -> None:
        self.node, self.prefix, self.timeout = node, prefix, timeout
        self.group = ReentrantCallbackGroup()
        self._clients: dict[str, Any] = {}

    def service(self, kind: Any, name: str) -> Any:
        """The client of a service."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(
                kind, self.prefix + name, callback_group=self.group
            )
        return self._clients[name]

    def action(self, kind: Any, name: str) -> Any:
        """The client of an action."""
        if name not in self._clients:
            self._clients[name] = ActionClient(
                self.node, kind, self.prefix + name, callback_group=self.group
            )
        return self._clients[name]

    def full_name(self, name: str) -> str:
        """The name with its namespace, after remapping."""
        return self.node.resolve_service_name(self.prefix + name)

    def appear(
        self, what: str, wait: Callable[..., bool], timeout: float, *, left: float | None = None
    ) -> None:
        """Wait for a service or an action (`wait`) to be there, as long as is `left` of `timeout`.

        Raises:
            GraspServerError: it is not.
            ExternalShutdownException: rclpy was shut down meanwhile.
        """
        if wait(timeout_sec=max(0.01, timeout if left is None else left)):
            return
        # A wait also ends, without success, when the process is told to end.
        if not self.node.context.ok():
            raise ExternalShutdownException
        raise GraspServerError(
            0,
            f"{what} is not there after {timeout:g} s; start the node that offers it in the same "
            "namespace and ROS_DOMAIN_ID",
        )

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """The answer of a service. Raises GraspServerError, for answers that are errors, too."""
        client = self.service(kind, name)
        self._must_spin()
        what = f"service {self.full_name(name)}"
        self.appear(what, client.wait_for_service, self.timeout)
        answer = send_in_executor(self.node, lambda: client.call_async(request), self.timeout)
        if answer is None:
            raise self._silent(what)
        if getattr(answer, "error_code", 0):
            raise GraspServerError(answer.error_code, answer.error_msg, answer)
        return answer

    def act(
        self,
        kind: Any,
        name: str,
        goal: Any,
        *,
        on_feedback: Callable[[Any], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> tuple[Any, bool]:
        """The result of a goal, errors included, and whether `cancelled` has ended it.

        Where waiting for it ends in another way, it is cancelled: nobody wants the result.
        """
        client = self.action(kind, name)
        self._must_spin()
        what = f"action {self.full_name(name)}"
        self.appear(what, client.wait_for_server, self.timeout)
        failed: list[Exception] = []

        def heard(message: Any) -> None:
            try:
                if on_feedback is not None:
                    on_feedback(message.feedback)
            except Exception as error:
                failed.append(error)

        def send() -> Any:
            return client.send_goal_async(goal, feedback_callback=heard)

        handle = send_in_executor(self.node, send, self.timeout)
        if handle is None:
            raise self._silent(what)
        if not handle.accepted:
            raise GraspServerError(0, f"{what} rejected the goal without a reason")
        asked = False

        def cancel() -> None:
            nonlocal asked
            if not asked and self.node.executor is not None:
                asked = True
                self.node.executor.create_task(handle.cancel_goal_async)

        def check() -> None:
            if failed:
                raise failed[0]
            if cancelled is not None and cancelled():
                cancel()

        try:
            answer = send_in_executor(
                self.node, handle.get_result_async, self.timeout, check=check
            )
        except Exception:
            cancel()
            raise
        if answer is None:
            cancel()
            raise self._silent(what)
        return answer.result, asked

    def until(self, look: Callable[[], T | None], timeout: float) -> T | None:
        """What `look` returns as soon as it is something, None after `timeout` seconds."""
        end = time.monotonic() + timeout
        while (found := look()) is None and time.monotonic() < end:
            if not self.node.context.ok():
                raise ExternalShutdownException
            time.sleep(SLICE)
        return found

    def _silent(self, what: str) -> GraspServerError:
        return GraspServerError(
            0,
            f"{what} did not answer within {self.timeout:g} s; look at the log of the node that "
            "offers it",
        )

    def _must_spin(self) -> None:
        if self.node.executor is None and self.node.context.ok():
            raise GraspServerError(
                0,
                f"nothing spins the node {self.node.get_fully_qualified_name()}; expected an "
                "executor in another thread. Add the node to one, or use GraspClient.open()",
            )


class CloudListener:
    """The newest cloud on `points`, subscribed to from now on and kept as it was received."""

    def __init__(self, caller: Caller, topic: str = "points") -> None:
        self._caller = caller
        self._topic = caller.node.resolve_topic_name(caller.prefix + topic)
        self._lock = threading.Lock()
        self._newest: tuple[int, bytes] = (0, b"")
        caller.node.create_subscription(
            PointCloud2, self._topic, self._keep, SENSOR, callback_group=caller.group, raw=True
        )

    def newest(self, timeout: float, after: TimeMessage | None = None) -> PointCloud2:
        """The newest cloud with a stamp later than `after`, or without that the next one to come.

        Raises GraspServerError when none comes within `timeout` seconds.
        """
        limit = 0 if after is None else Time.from_msg(after).nanoseconds
        seen = self._newest[0] if after is None else 0
        came = False

        def newer() -> PointCloud2 | None:
            nonlocal seen, came
            with self._lock:
                count, data = self._newest
            if count == seen:
                return None
            seen, came = count, True
            cloud: PointCloud2 = deserialize_message(data, PointCloud2)
            return cloud if Time.from_msg(cloud.header.stamp).nanoseconds > limit else None

        found = self._caller.until(newer, timeout)
        if found is None:
            which = "cloud that is new enough" if came else "cloud"
            raise GraspServerError(
                ErrorCode.NO_CLOUD,
                f"no {which} came on {self._topic} within {timeout:g} s; start the camera, or "
                "remap points",
            )
        return found

    def _keep(self, data: bytes) -> None:
        with self._lock:
            self._newest = self._newest[0] + 1, data

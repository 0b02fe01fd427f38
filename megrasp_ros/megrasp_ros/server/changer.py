"""The tool changer as a blocking call, for the worker's thread."""

from __future__ import annotations

import time

from megrasp_msgs.srv import ChangeTool
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from megrasp_ros.errors import NoChangerError
from megrasp_ros.waiting import wait_for_future

from .worker import Job

THERE = 10.0
"""Longest wait (s) for the service to appear, and"""

ANSWER = 60.0
"""for its answer."""

SLICE = 0.2


class Changer:
    """Asks a ChangeTool service; the node's executor brings the answer."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = ReentrantCallbackGroup()

    def mount(self, service: str, name: str, job: Job) -> ChangeTool.Response | None:
        """Return the answer to `mount this gripper`, None when none came in time.

        Raises NoChangerError when there is no such service, and what `job.check` raises.
        """
        client = self._node.create_client(ChangeTool, service, callback_group=self._group)
        try:
            end = time.monotonic() + THERE
            while not client.wait_for_service(timeout_sec=SLICE):
                job.check()
                if time.monotonic() > end:
                    raise NoChangerError(
                        f"no service {service!r} after {THERE:g} s; expected the tool changer. "
                        "Start it, or set the parameter tool_changer to the name of its "
                        "ChangeTool service. Nothing was changed."
                    )
            return wait_for_future(
                client.call_async(ChangeTool.Request(gripper_name=name)),
                ANSWER,
                context=self._node.context,
                check=job.check,
            )
        finally:
            self._node.destroy_client(client)

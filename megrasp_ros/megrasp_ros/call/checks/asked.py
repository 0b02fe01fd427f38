"""Whom `doctor` asks, and for how long it waits for what the network has yet to tell."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException

from megrasp_ros.client import GraspClient


class Asked:
    """A server that is looked at.

    Args:
        client: in the namespace of the server.
        server: name of its node.
        seconds: how long topics are listened to.
        patience: longest wait (s), from now on, for nodes and topics to be discovered; a quarter
            of it is left to whatever is waited for later.
    """

    def __init__(
        self, client: GraspClient, server: str, *, seconds: float, patience: float
    ) -> None:
        self.client, self.node, self.server = client, client.node, server
        self.seconds, self._patience = seconds, patience
        self._started = time.monotonic()

    @property
    def full_name(self) -> str:
        """Of the server's node, with its namespace."""
        return f"{self.node.get_namespace().rstrip('/')}/{self.server}"

    def until(self, done: Callable[[], bool], seconds: float | None = None) -> None:
        """Wait for what the network has yet to tell: who has listened for long has heard it.

        seconds: from now on, in place of the patience.
        """
        now = time.monotonic()
        if seconds is None:
            end = max(self._started + self._patience, now + self._patience / 4)
        else:
            end = now + seconds
        while not done() and time.monotonic() < end:
            self.pause(0.05)

    def pause(self, seconds: float) -> None:
        """Let time pass.

        Raises:
            ExternalShutdownException: ROS went down.
        """
        if not self.node.context.ok():
            raise ExternalShutdownException
        time.sleep(seconds)

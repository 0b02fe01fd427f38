"""Waiting for rclpy futures from a thread that does not spin."""

from __future__ import annotations

import threading
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.task import Future

SLICE = 0.2
"""SIGTERM shuts rclpy down without waking a waiting thread, so look for it this often (s)."""


def wait_for_future(
    future: Future, timeout: float, *, context: Context | None = None
) -> Any | None:
    """The future's result, or None after `timeout` seconds without one (it is then cancelled).

    context: that of the node, None for rclpy's default one.
    Somebody else must spin the node, and not from the calling thread. Raises what the future
    raised, and ExternalShutdownException when the process is told to end meanwhile.
    """
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    end = time.monotonic() + timeout
    while not done.wait(min(SLICE, max(0.0, end - time.monotonic()))):
        if not rclpy.ok(context=context):
            raise ExternalShutdownException
        if time.monotonic() >= end:
            future.cancel()
            return None
    return future.result()

"""Spinning that outlives subscriptions and clients which other threads destroy."""

from __future__ import annotations

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor


def spin(executor: Executor) -> None:
    """Spin until rclpy is shut down.

    rclpy lets an executor meet a handle that another thread has just destroyed: it guards itself
    in most places, but not where it collects the events of subscriptions. What was collected is
    then dropped and collected anew, which is all that is needed.

    Raises what `Executor.spin` raises but that.
    """
    while True:
        try:
            return executor.spin()
        except InvalidHandle:
            if not rclpy.ok():
                return None

"""Spinning that outlives subscriptions and clients which other threads destroy."""

from __future__ import annotations

import time
from collections import deque

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.logging import get_logger

MOST = 100
"""Destroyed handles met within a second after which it is no coincidence any more."""

_log = get_logger("megrasp_ros")


def spin(executor: Executor) -> None:
    """Spin until rclpy is shut down.

    rclpy lets an executor meet a handle that another thread has just destroyed: it guards itself
    in most places, but not where it collects the events of subscriptions. What was collected is
    then dropped and collected anew, which is all that is needed.

    Raises what `Executor.spin` raises; that error only when it comes again and again.
    """
    met: deque[float] = deque(maxlen=MOST)
    while True:
        try:
            return executor.spin()
        except InvalidHandle as error:
            if not rclpy.ok():
                return None
            met.append(time.monotonic())
            if len(met) == MOST and met[-1] - met[0] < 1.0:
                raise
            _log.debug(f"spinning goes on after a destroyed handle: {error}")

"""Spinning that outlives whatever a callback or a client's message does to it."""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable

from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.logging import get_logger

MOST = 100
"""Failures within a second after which going on is of no use."""

_log = get_logger("megrasp_ros")


def spin(executor: Executor, ended: Callable[[], bool] | None = None) -> None:
    """Spin until rclpy is shut down, or until `ended` and the executor is.

    An exception of a callback, or of a message that cannot be read, ends rclpy's `spin`. Here it
    is logged and spinning goes on. Callbacks should be guarded all the same (guard.py): a service
    that failed has not answered.

    rclpy also lets an executor meet a handle that another thread has just destroyed: it guards
    itself in most places, but not where it collects the events of subscriptions. What was
    collected is then dropped and collected anew, which is all that is needed.

    Raises the exception when it comes again and again, and ExternalShutdownException.
    """
    met: deque[float] = deque(maxlen=MOST)
    while True:
        try:
            return executor.spin()
        except ExternalShutdownException:
            raise
        except Exception as error:
            if not executor.context.ok() or (ended is not None and ended()):
                return None
            met.append(time.monotonic())
            if len(met) == MOST and met[-1] - met[0] < 1.0:
                raise
            if isinstance(error, InvalidHandle):
                _log.debug(f"spinning goes on after a destroyed handle: {error}")
            else:
                _log.error(f"spinning goes on after\n{traceback.format_exc()}")

"""An action server that knows which results are still to be sent."""

from __future__ import annotations

import weakref
from collections.abc import Iterable
from typing import Any

from rclpy.action import ActionServer
from rclpy.task import Future


class GoalServer(ActionServer):
    """rclpy's action server, whose owner can wait at its end until its clients know.

    A result goes out when it is there and its client has asked for it, in whichever order that
    comes. rclpy does not tell when both have happened.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Take what rclpy's class takes."""
        self._sent: weakref.WeakSet[Future] = weakref.WeakSet()
        super().__init__(*arguments, **options)

    def owed(self) -> list[Future]:
        """Return the results of accepted goals that are not there yet."""
        return [future for future in list(self._result_futures.values()) if not future.done()]

    def sent(self, results: Iterable[Future]) -> bool:
        """Whether all of these results have gone out."""
        return all(future in self._sent for future in results)

    def _send_result_response(self, request_header: Any, future: Future) -> None:
        super()._send_result_response(request_header, future)
        self._sent.add(future)

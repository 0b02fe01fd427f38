"""One guard for all callbacks: what fails in one of them is logged and answered, and the node goes
on.

rclpy lets an exception of a callback end `spin`, and with it the process. A node that inherits
`Guarded` (before rclpy's class) has every callback of its services, subscriptions and timers
wrapped, those of rclpy itself (parameters, lifecycle) included; the callbacks of an action server
are wrapped by hand, see `Guard`.
"""

from __future__ import annotations

import functools
import inspect
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.context import Context
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from .errors import describe, is_expected

REPEAT = 60.0
"""The same failure of the same callback is logged again after this time (s)."""

Callback = Callable[..., Any]

_MARK = "megrasp_guarded"


class Guard:
    """Wraps callbacks; a wrapped one returns or raises nothing but what it should.

    Attributes:
        waiting: requests whose answer waits for something else, such as a job.
    """

    def __init__(self, log: RcutilsLogger, context: Context) -> None:
        self._log, self._context = log, context
        self.waiting = 0
        self._lock = threading.Lock()
        self._told: dict[str, tuple[str, float]] = {}

    def tell(self, what: str, error: BaseException) -> str:
        """Log a failure, unless it was told a moment ago; return its text."""
        text = describe(error)[1]
        if not self._context.ok():
            # What a callback in mid-work asks of ROS after SIGINT fails because ROS is gone.
            self._log.debug(f"{what}, while ending: {text}")
            return text
        last, at = self._told.get(what, ("", 0.0))
        now = time.monotonic()
        if text != last or now - at > REPEAT:
            self._told[what] = (text, now)
            trace = "" if is_expected(error) else "\n" + "".join(traceback.format_exception(error))
            self._log.error(f"{what}: {text}{trace}")
        return text

    def plain(self, what: str, callback: Callback, otherwise: Any = None) -> Callback:
        """Wrap a callback without an answer, or one whose answer is `otherwise` after a failure.

        Its arguments stay visible to rclpy, which looks at them.
        """

        @functools.wraps(callback)
        def call(*arguments: Any, **named: Any) -> Any:
            try:
                return callback(*arguments, **named)
            except Exception as error:
                self.tell(what, error)
                return otherwise

        return call

    def service(self, what: str, callback: Callback) -> Callback:
        """Wrap the callback of a service, which then answers every request."""
        if inspect.iscoroutinefunction(callback):

            @functools.wraps(callback)
            async def answer_later(request: Any, response: Any) -> Any:
                self._count(1)
                try:
                    return await callback(request, response)
                except Exception as error:
                    return self._refusal(what, error, request, response)
                finally:
                    self._count(-1)

            return _marked(answer_later)

        @functools.wraps(callback)
        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                return self._refusal(what, error, request, response)

        return _marked(answer)

    def _count(self, more: int) -> None:
        with self._lock:
            self.waiting += more

    def _refusal(self, what: str, error: Exception, request: Any, response: Any) -> Any:
        """Return an answer that says no in the words of its kind."""
        text = self.tell(what, error)
        fields = response.get_fields_and_field_types()
        if "error_code" in fields:
            refused = type(response)()
            refused.error_code, refused.error_msg = describe(error)
            return refused
        no = SetParametersResult(successful=False, reason=text)
        if fields.get("results") == "sequence<rcl_interfaces/SetParametersResult>":
            # Those before the failure have been set.
            missing = len(request.parameters) - len(response.results)
            response.results = [*response.results, *[no] * missing]
            return response
        if fields.get("result") == "rcl_interfaces/SetParametersResult":
            response.result = no
            return response
        return type(response)()


class Guarded(Node):
    """A node whose callbacks are guarded."""

    _guard: Guard | None = None

    @property
    def guard(self) -> Guard:
        """The guard, for callbacks that are made elsewhere, such as those of an action server."""
        if self._guard is None:
            self._guard = Guard(self.get_logger(), self.context)
        return self._guard

    def create_service(self, srv_type: Any, srv_name: str, callback: Callback, **options: Any):
        """As rclpy's, guarded."""
        return super().create_service(
            srv_type, srv_name, self.guard.service(srv_name, callback), **options
        )

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callback, qos_profile: Any, **options: Any
    ) -> Subscription:
        """As rclpy's, guarded."""
        guarded = self.guard.plain(f"subscription of {topic}", callback)
        return super().create_subscription(msg_type, topic, guarded, qos_profile, **options)

    def create_timer(
        self, timer_period_sec: float, callback: Callback, *arguments: Any, **options: Any
    ) -> Timer:
        """As rclpy's, guarded."""
        guarded = self.guard.plain(f"timer {getattr(callback, '__name__', '')}", callback)
        return super().create_timer(timer_period_sec, guarded, *arguments, **options)

    def guard_rest(self) -> None:
        """Guard the services that rclpy has made without asking the node."""
        for service in self.services:
            if not hasattr(service.callback, _MARK):
                service.callback = self.guard.service(service.service_name, service.callback)


def _marked(callback: Callback) -> Callback:
    setattr(callback, _MARK, True)
    return callback

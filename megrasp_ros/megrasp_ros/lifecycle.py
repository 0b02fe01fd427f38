"""A lifecycle node that no client can end: every callback guarded, every transition checked."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn
from rclpy.service import Service

from .guard import Guarded

Callback = Callable[[Any, Any], Any]


class GuardedLifecycleNode(LifecycleNodeMixin, Guarded):
    """As rclpy's LifecycleNode, with three differences.

    A transition that is not possible is answered with success false (rclpy's raises, which ends
    the process). So is one that comes while another is going on. Its services answer while a
    transition takes its time.
    """

    def __init__(self, name: str, **options: Any) -> None:
        """Make the node; `options` are those of rclpy's Node."""
        Guarded.__init__(self, name, **options)
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        self._moving = threading.Lock()
        self._possible: Callback = self._service("get_available_transitions").callback
        change: Any = self._service("change_state")
        change.callback = self._checked(change.callback)
        self.guard_rest()

    def transition(self, number: int) -> bool:
        """Make a transition (a constant of lifecycle_msgs/Transition); return whether it was made.

        For the node itself; the executor's threads may serve others meanwhile.
        """
        callbacks = {
            Transition.TRANSITION_CONFIGURE: self.trigger_configure,
            Transition.TRANSITION_ACTIVATE: self.trigger_activate,
        }
        with self._moving:
            if number not in self._possible_ids():
                return False
            return callbacks[number]() == TransitionCallbackReturn.SUCCESS

    def _service(self, name: str) -> Service:
        full = f"{self.get_fully_qualified_name().rstrip('/')}/{name}"
        return next(each for each in self.services if each.service_name == full)

    def _available(self) -> list[Transition]:
        answer = self._possible(
            GetAvailableTransitions.Request(), GetAvailableTransitions.Response()
        )
        return [each.transition for each in answer.available_transitions]

    def _possible_ids(self) -> set[int]:
        return {each.id for each in self._available()}

    def _checked(self, callback: Callback) -> Callback:
        def change(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            asked = request.transition
            if not self._moving.acquire(blocking=False):
                self._refuse(asked, "another transition is going on")
                return response
            try:
                available = self._available()
                known = (
                    asked.label in {each.label for each in available}
                    if asked.label
                    else asked.id in {each.id for each in available}
                )
                if not known:
                    names = ", ".join(f"{each.label} ({each.id})" for each in available)
                    self._refuse(asked, f"possible now: {names or 'none'}")
                    return response
                return callback(request, response)
            finally:
                self._moving.release()

        return change

    def _refuse(self, asked: Transition, why: str) -> None:
        self.get_logger().warning(
            f"transition {asked.label[:40] or asked.id} was asked for and is not possible; {why}"
        )

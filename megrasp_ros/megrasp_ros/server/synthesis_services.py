"""The three ways to a synthesis: the service, the action, and by itself for every new cloud."""

from __future__ import annotations

import time
from collections.abc import Callable

from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import SynthesizeGrasps
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.lifecycle import LifecycleNode

from megrasp_core.errors import CancelledError, MegraspError
from megrasp_ros.errors import describe

from . import parameters
from .grasp_messages import Outcome
from .parameters import Settings
from .requests import ParsedRequest, automatic_request, checked_request
from .synthesis import OnStep
from .worker import Job, Worker

RESULT_TIMEOUT = 900
"""Seconds that an action result is kept; the default differs between ROS distributions."""

Synthesize = Callable[[Job, ParsedRequest, Settings, OnStep | None], Outcome]
"""Computes and publishes; runs in the worker thread."""

_CANCELLED = "the client cancelled the goal; send it again if it is needed."


class SynthesisServices:
    """Serves synthesize_grasps and generate_grasps; `on_cloud` is auto_synthesize.

    last, latency: text and seconds of the last request, for diagnostics.
    """

    def __init__(
        self,
        node: LifecycleNode,
        worker: Worker,
        synthesize: Synthesize,
        require_active: Callable[[], None],
        group: CallbackGroup,
    ) -> None:
        self._node, self._worker = node, worker
        self._synthesize, self._require_active = synthesize, require_active
        self._automatic_at = float("-inf")
        self.last = ""
        self.latency = 0.0
        node.create_service(
            SynthesizeGrasps, "synthesize_grasps", self._on_request, callback_group=group
        )
        self._action = ActionServer(
            node,
            GenerateGrasps,
            "generate_grasps",
            self._on_goal,
            callback_group=group,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT,
        )

    def on_cloud(self) -> None:
        """Start an automatic synthesis, unless one was started too recently or a job runs."""
        settings = parameters.read(self._node)
        now = time.monotonic()
        if self._worker.current is not None or now - self._automatic_at < settings.auto_period:
            return
        self._automatic_at = now
        request = automatic_request(settings)

        def work(job: Job) -> None:
            try:
                self._report(self._synthesize(job, request, settings, None), job)
            except CancelledError:
                # Somebody's request took over; the next cloud will come.
                return
            except Exception as error:
                self._report(Outcome(*describe(error)), job)

        try:
            self._require_active()
            self._worker.submit(Job("auto_synthesize", work, request.timeout, background=True))
        except MegraspError:
            # The same, a moment earlier.
            return

    def _on_request(
        self, message: SynthesizeGrasps.Request, response: SynthesizeGrasps.Response
    ) -> SynthesizeGrasps.Response:
        try:
            self._require_active()
            settings = parameters.read(self._node)
            request = checked_request(message, settings)

            def work(job: Job) -> Outcome:
                return self._synthesize(job, request, settings, None)

            job = self._worker.submit(Job("synthesize_grasps", work, request.timeout))
        except MegraspError as error:
            return self._refused("synthesize_grasps", error).fill(response)
        return self._outcome(job).fill(response)

    def _on_goal(self, handle: ServerGoalHandle) -> GenerateGrasps.Result:
        result = GenerateGrasps.Result()
        try:
            self._require_active()
            settings = parameters.read(self._node)
            request = checked_request(handle.request, settings)

            def work(job: Job) -> Outcome:
                return self._synthesize(job, request, settings, _feedback(handle, job))

            job = Job("generate_grasps", work, request.timeout)
            self._worker.submit(job, preempt=handle.request.preempt)
        except MegraspError as error:
            handle.abort()
            return self._refused("generate_grasps", error).fill(result)
        while not job.done.wait(0.01):
            if handle.is_cancel_requested:
                job.cancel(_CANCELLED)
        outcome = self._outcome(job)
        if outcome.error_code == ErrorCode.NONE:
            handle.succeed()
        elif outcome.error_code == ErrorCode.CANCELLED and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return outcome.fill(result)

    def _outcome(self, job: Job) -> Outcome:
        """Wait for a synthesis job; its errors become outcomes."""
        try:
            outcome = job.wait()
        except Exception as error:
            outcome = Outcome(*describe(error))
            outcome.timing.total = job.elapsed
        self._report(outcome, job)
        return outcome

    def _report(self, outcome: Outcome, job: Job) -> None:
        self.latency = job.elapsed
        log = self._node.get_logger()
        if outcome.error_code:
            self.last = f"error {outcome.error_code}: {outcome.error_msg}"
            log.warning(f"{job.what}: {self.last}")
            return
        grasps = outcome.grasps
        self.last = (
            f"{len(grasps.grasps)} grasps of {grasps.gripper}, seed {grasps.seed}, "
            f"{job.elapsed:.2f} s"
        )
        log.info(f"{job.what}: {self.last}")

    def _refused(self, what: str, error: MegraspError) -> Outcome:
        outcome = Outcome(*describe(error))
        self._node.get_logger().warning(f"{what}: error {outcome.error_code}: {outcome.error_msg}")
        return outcome


def _feedback(handle: ServerGoalHandle, job: Job) -> OnStep:
    def publish(phase: str, step: int, total: int) -> None:
        if handle.is_cancel_requested:
            job.cancel(_CANCELLED)
        if handle.is_active:
            handle.publish_feedback(
                GenerateGrasps.Feedback(
                    phase=phase, step=step, total_steps=total, elapsed=job.elapsed
                )
            )

    return publish

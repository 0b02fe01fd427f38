"""The three ways to a synthesis: the service, the action, and by itself for every new cloud."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode, GraspArray
from megrasp_msgs.srv import SynthesizeGrasps
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import CancelledError, MegraspError
from megrasp_ros.errors import describe
from megrasp_ros.lifecycle import GuardedLifecycleNode
from megrasp_ros.pacing import Gate, paced
from megrasp_ros.qos import CALLS
from megrasp_ros.waiting import wake_when

from . import parameters
from .goal_server import GoalServer
from .grasp_messages import Outcome
from .parameters import Settings
from .requests import ParsedRequest, automatic_request, checked_request
from .synthesis import OnStep
from .worker import Job, Worker

Synthesize = Callable[[Job, ParsedRequest, Settings, OnStep | None], Outcome]
"""Computes and publishes; runs in the worker thread."""

Ended = Callable[[Job], Awaitable[None]]
"""Waits for the end of a job without holding a thread of the executor."""

GOAL_GAP = 0.04
"""Gap (s) of the gates for goals: at each step their clients take the status of all."""

_CANCELLED = "the client cancelled the goal; send it again if it is needed."
_CANCEL_WAIT = 2.0
"""A cancelled goal becomes one just after its work was told to stop; wait for that so long (s)."""


class SynthesisServices:
    """Serves synthesize_grasps and generate_grasps; `on_cloud` is auto_synthesize.

    goals: the action server. last, latency: text and seconds of the last request, for
    diagnostics.
    """

    def __init__(
        self,
        node: GuardedLifecycleNode,
        worker: Worker,
        synthesize: Synthesize,
        require_active: Callable[[], None],
        ended: Ended,
        group: CallbackGroup,
    ) -> None:
        self._node, self._worker, self._ended = node, worker, ended
        self._synthesize, self._require_active = synthesize, require_active
        self._automatic_at = float("-inf")
        self._goals: dict[bytes, Job] = {}
        self._accepted, self._results = Gate(gap=GOAL_GAP), Gate(gap=GOAL_GAP, quiet=0.0)
        self.last, self.latency = "", 0.0
        node.create_service(
            SynthesizeGrasps,
            "synthesize_grasps",
            paced(self._on_request, node),
            callback_group=group,
            qos_profile=CALLS,
        )
        self.goals = GoalServer(
            node,
            GenerateGrasps,
            "generate_grasps",
            self._on_goal,
            callback_group=group,
            goal_callback=self._on_goal_request,
            cancel_callback=node.guard.plain(
                "cancelling a goal", self._on_cancel, CancelResponse.REJECT
            ),
            goal_service_qos_profile=CALLS,
            result_service_qos_profile=CALLS,
            cancel_service_qos_profile=CALLS,
            # rclpy takes whole seconds in some versions.
            result_timeout=max(1, round(float(node.get_parameter("result_timeout").value or 0))),
        )

    def close(self) -> None:
        """Destroy the action server, which rclpy's destroy_node does not."""
        self.goals.destroy()

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

    async def _on_request(
        self, message: SynthesizeGrasps.Request, response: SynthesizeGrasps.Response
    ) -> SynthesizeGrasps.Response:
        try:
            job = self._submit("synthesize_grasps", message, lambda job: None)
            await self._ended(job)
            outcome = self._outcome(job)
        except MegraspError as error:
            outcome = self._refused("synthesize_grasps", error)
        return outcome.fill(response)

    async def _on_goal_request(self, _: GenerateGrasps.Goal) -> GoalResponse:
        await wake_when(self._accepted.enter, self._node)
        return GoalResponse.ACCEPT

    async def _on_goal(self, handle: ServerGoalHandle) -> GenerateGrasps.Result:
        result, goal = GenerateGrasps.Result(), bytes(handle.goal_id.uuid)
        feedback = _Feedback(handle)
        try:
            job = self._submit(
                "generate_grasps",
                handle.request,
                feedback.of,
                preempt=handle.request.preempt,
                note=lambda job: self._goals.__setitem__(goal, job),
            )
            if handle.is_cancel_requested:
                job.cancel(_CANCELLED)
            await self._ended(job)
            outcome = self._outcome(job)
            if outcome.error_code == ErrorCode.CANCELLED:
                outcome.grasps = feedback.grasps
        except MegraspError as error:
            outcome = self._refused("generate_grasps", error)
        except Exception as error:
            self._node.guard.tell("generate_grasps", error)
            outcome = Outcome(*describe(error))
        self._goals.pop(goal, None)
        # rclpy keeps the goal as long as its result.
        handle.request.cloud = PointCloud2()
        handle.request.exclude = []
        await wake_when(self._results.enter, self._node)
        await self._finish(handle, outcome)
        return outcome.fill(result)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        job = self._goals.get(bytes(handle.goal_id.uuid))
        if job is not None:
            job.cancel(_CANCELLED)
        return CancelResponse.ACCEPT

    def _submit(
        self,
        what: str,
        message: Any,
        steps: Callable[[Job], OnStep | None],
        *,
        preempt: bool = False,
        note: Callable[[Job], None] = lambda job: None,
    ) -> Job:
        """Check a request and start its job; `note` gets the job before that."""
        # `timeout` counts everything from here on.
        started = time.monotonic()
        self._require_active()
        settings = parameters.read(self._node)
        request = checked_request(message, settings)

        def work(job: Job) -> Outcome:
            return self._synthesize(job, request, settings, steps(job))

        job = Job(what, work, request.timeout, preemptible=True, started=started)
        note(job)
        return self._worker.submit(job, preempt=preempt)

    async def _finish(self, handle: ServerGoalHandle, outcome: Outcome) -> None:
        """Bring a goal into its last state."""
        if outcome.error_code == ErrorCode.NONE:
            handle.succeed()
            return
        if outcome.error_code == ErrorCode.CANCELLED and outcome.error_msg == _CANCELLED:
            # The client's wish arrives here before rclpy has noted it.
            end = time.monotonic() + _CANCEL_WAIT
            while not handle.is_cancel_requested and time.monotonic() < end:
                await wake_when(lambda wake: threading.Timer(0.01, wake).start(), self._node)
            if handle.is_cancel_requested:
                handle.canceled()
                return
        handle.abort()

    def _outcome(self, job: Job) -> Outcome:
        """Return the outcome of a synthesis job that has ended; its errors become outcomes."""
        try:
            outcome = job.outcome()
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


class _Feedback:
    """Tells the client of a goal how far it is; keeps the latest unfinished grasps."""

    def __init__(self, handle: ServerGoalHandle) -> None:
        self._handle = handle
        self.grasps = GraspArray()

    def of(self, job: Job) -> OnStep:
        """Return what is called at each step of the job."""

        def publish(phase: str, step: int, total: int, grasps: GraspArray | None) -> None:
            if grasps is not None:
                self.grasps = grasps
            if self._handle.is_active:
                self._handle.publish_feedback(
                    GenerateGrasps.Feedback(
                        phase=phase,
                        step=step,
                        total_steps=total,
                        elapsed=job.elapsed,
                        grasps=grasps or GraspArray(),
                    )
                )

        return publish

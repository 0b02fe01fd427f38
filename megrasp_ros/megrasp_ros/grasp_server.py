"""Node that turns point clouds into grasps: topics, services, action and parameters of INTERFACES, "ROS 2".

The node is thin. One worker thread computes (worker.py, engine.py, synthesis.py); the executor's threads only wait
for it, so that cancelling, parameters and diagnostics stay responsive.
"""

from __future__ import annotations

import logging
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from megrasp_core.errors import MegraspError
from megrasp_core.grippers import Gripper
from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import SynthesizeGrasps
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from megrasp_ros import parameters
from megrasp_ros.clouds import CloudSource
from megrasp_ros.diagnostics import diagnostics
from megrasp_ros.engine import Engine, Factory, load_synthesizer
from megrasp_ros.errors import BinEmptyError, NotActiveError, describe
from megrasp_ros.frames import FrameSource, TransformBuffer
from megrasp_ros.grasp_messages import Outcome
from megrasp_ros.gripper_services import GripperServices
from megrasp_ros.logs import forward_logs
from megrasp_ros.outputs import Outputs
from megrasp_ros.parameters import Settings
from megrasp_ros.requests import Request, automatic_request, checked_request
from megrasp_ros.synthesis import OnStep, Synthesis
from megrasp_ros.worker import Job, Worker

RESULT_TIMEOUT = 900  # s that an action result is kept; the default differs between ROS distributions


class GraspServer(LifecycleNode):
    """Lifecycle node `grasp_server`. `factory` makes the synthesizer, `buffer` replaces tf2."""

    def __init__(self, *, factory: Factory = load_synthesizer, buffer: TransformBuffer | None = None) -> None:
        super().__init__("grasp_server")
        parameters.declare(self)
        group = ReentrantCallbackGroup()
        self._is_active = False
        self._error = self._last = ""
        self._latency = 0.0
        self._automatic_at = float("-inf")
        self._engine = Engine(factory)
        self._worker = Worker()
        self._clouds = CloudSource(self)
        self._synthesis = Synthesis(self._engine, self._clouds, FrameSource(self, buffer))
        self._outputs = Outputs(self)
        self._grippers = GripperServices(
            self, self._engine, self._outputs, self._worker, self._run_job, group
        )
        self.create_service(SynthesizeGrasps, "synthesize_grasps", self._on_synthesize, callback_group=group)
        self._action = ActionServer(
            self,
            GenerateGrasps,
            "generate_grasps",
            self._on_goal,
            callback_group=group,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT,
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.create_timer(1.0, self._publish_diagnostics, callback_group=MutuallyExclusiveCallbackGroup())
        self.add_post_set_parameters_callback(self._after_parameters)

    # Lifecycle ------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Configure and activate, if the parameter `autostart` says so."""
        if self.get_parameter("autostart").value:
            self.trigger_configure()
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load model and gripper. A failure is logged and answered to requests; the node keeps serving."""
        started = time.monotonic()
        settings = parameters.read(self)
        try:
            self._worker.submit(Job("configure", lambda job: self._load(settings))).wait()
        except Exception as error:
            self._error = describe(error)[1]
            self.get_logger().error(self._error)
        else:
            self.get_logger().info(
                f"model {self._engine.model_id!r} on {self._engine.device}, gripper "
                f"{self._engine.active.name if self._engine.active else None!r}, loaded in "
                f"{time.monotonic() - started:.1f} s"
            )
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to answer requests."""
        result = super().on_activate(state)
        self._is_active = True
        self._grippers.publish_active()
        self._follow_points(parameters.read(self))
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel what runs and stop to answer requests."""
        self._stop_serving()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the model."""
        self._engine.unload()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel what runs."""
        self._stop_serving()
        return super().on_shutdown(state)

    def close(self) -> None:
        """End the worker thread; the node is of no use afterwards."""
        self._is_active = False
        self._worker.close()

    def _stop_serving(self) -> None:
        self._is_active = False
        self._clouds.set_continuous(False)
        job = self._worker.current
        if job is not None:
            job.cancel("the node is being deactivated; activate it and send the request again.")
            job.done.wait(30.0)

    # Jobs -----------------------------------------------------------------------------------------------------

    def _load(self, settings: Settings) -> None:
        # The gripper first: it can be listed and set even where the model is missing.
        self._grippers.follow_parameter(settings)
        self._engine.load_model(settings)
        active = self._engine.active
        if active is not None:
            self._engine.use(active)
        self._error = ""

    def _require_active(self) -> None:
        if not self._is_active:
            raise NotActiveError(
                "the lifecycle node is not active; expected the state `active`. Configure and activate it, for "
                f"instance: ros2 lifecycle set {self.get_fully_qualified_name()} configure, then activate; or start "
                "it with autostart: true."
            )

    def _run_job(self, what: str, work) -> object:  # noqa: ANN001  (see gripper_services.RunJob)
        self._require_active()
        return self._worker.submit(Job(what, work)).wait()

    def _synthesize(
        self, job: Job, request: Request, settings: Settings, on_step: OnStep | None = None
    ) -> Outcome:
        """Work of a synthesis job: compute, then publish."""
        try:
            grippers = self._grippers.chosen(request.gripper_name, settings)
            self._engine.load_model(settings)
            self._error = ""
            outcome = self._synthesis.run(job, request, settings, grippers, on_step)
        except BinEmptyError:
            self._outputs.nothing(settings.planning_frame)
            raise
        except Exception as error:
            if describe(error)[0] in (ErrorCode.MODEL_NOT_LOADED, ErrorCode.INTERNAL):
                self._error = describe(error)[1]
            raise
        self._publish(outcome, grippers, settings)
        return outcome

    def _publish(self, outcome: Outcome, grippers: list[Gripper], settings: Settings) -> None:
        chosen = next((each for each in grippers if each.name == outcome.grasps.gripper), None)
        reference = self._grippers.gripper_from_reference(chosen, settings) if chosen else None
        self._outputs.grasps(outcome.grasps, chosen, reference)
        self._outputs.scene(outcome.grasps.header, lambda: self._synthesis.last_points)

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
        self._latency = job.elapsed
        if outcome.error_code:
            self._last = f"error {outcome.error_code}: {outcome.error_msg}"
            self.get_logger().warning(f"{job.what}: {self._last}")
            return
        self._last = (
            f"{len(outcome.grasps.grasps)} grasps of {outcome.grasps.gripper}, seed {outcome.grasps.seed}, "
            f"{job.elapsed:.2f} s"
        )
        self.get_logger().info(f"{job.what}: {self._last}")

    # Service, action, automatic -------------------------------------------------------------------------------

    def _on_synthesize(
        self, message: SynthesizeGrasps.Request, response: SynthesizeGrasps.Response
    ) -> SynthesizeGrasps.Response:
        try:
            self._require_active()
            settings = parameters.read(self)
            request = checked_request(message, settings)
            job = self._worker.submit(
                Job("synthesize_grasps", lambda job: self._synthesize(job, request, settings), request.timeout)
            )
        except MegraspError as error:
            return self._refused("synthesize_grasps", error).fill(response)
        return self._outcome(job).fill(response)

    def _on_goal(self, handle: ServerGoalHandle) -> GenerateGrasps.Result:
        result = GenerateGrasps.Result()
        try:
            self._require_active()
            settings = parameters.read(self)
            request = checked_request(handle.request, settings)
            job = Job("generate_grasps", lambda job: None, request.timeout)
            job.work = lambda job: self._synthesize(job, request, settings, self._feedback(handle, job))
            self._worker.submit(job, preempt=handle.request.preempt)
        except MegraspError as error:
            handle.abort()
            return self._refused("generate_grasps", error).fill(result)
        while not job.done.wait(0.01):
            if handle.is_cancel_requested:
                job.cancel("the client cancelled the goal; send it again if it is needed.")
        outcome = self._outcome(job)
        if outcome.error_code == 0:
            handle.succeed()
        elif outcome.error_code == ErrorCode.CANCELLED and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return outcome.fill(result)

    def _feedback(self, handle: ServerGoalHandle, job: Job) -> OnStep:
        def publish(phase: str, step: int, total: int) -> None:
            if handle.is_cancel_requested:
                job.cancel("the client cancelled the goal; send it again if it is needed.")
            if handle.is_active:
                handle.publish_feedback(
                    GenerateGrasps.Feedback(phase=phase, step=step, total_steps=total, elapsed=job.elapsed)
                )

        return publish

    def _refused(self, what: str, error: MegraspError) -> Outcome:
        outcome = Outcome(*describe(error))
        self.get_logger().warning(f"{what}: error {outcome.error_code}: {outcome.error_msg}")
        return outcome

    def _on_cloud(self) -> None:
        settings = parameters.read(self)
        now = time.monotonic()
        if not self._is_active or self._worker.current is not None:
            return
        if now - self._automatic_at < settings.auto_period:
            return
        self._automatic_at = now
        request = automatic_request(settings)
        job = Job("auto_synthesize", lambda job: None, request.timeout)

        def work(job: Job) -> None:
            try:
                self._report(self._synthesize(job, request, settings), job)
            except Exception as error:
                self._report(Outcome(*describe(error)), job)

        job.work = work
        try:
            self._worker.submit(job)
        except MegraspError:
            # Somebody's request was faster; the next cloud will come.
            return

    # Parameters and diagnostics -------------------------------------------------------------------------------

    def _after_parameters(self, changed: list[Parameter]) -> None:
        if {"auto_synthesize", "points_subscription"} & {parameter.name for parameter in changed}:
            self._follow_points(parameters.read(self))

    def _follow_points(self, settings: Settings) -> None:
        automatic = settings.auto_synthesize == "on_cloud"
        self._clouds.on_cloud = self._on_cloud if automatic else None
        self._clouds.set_continuous(
            self._is_active and (automatic or settings.points_subscription == "continuous")
        )

    def _publish_diagnostics(self) -> None:
        settings, job, active = parameters.read(self), self._worker.current, self._engine.active
        frame = settings.planning_frame or "frame of the cloud"
        self._diagnostics.publish(
            diagnostics(
                name=self.get_fully_qualified_name(),
                stamp=self.get_clock().now().to_msg(),
                state="active" if self._is_active else "not active",
                error=self._error,
                gripper=active.name if active else "",
                tool_id=self._grippers.tool_id,
                model=self._engine.model_id,
                device=self._engine.device,
                clouds=self._clouds.count,
                cloud_rate=self._clouds.rate,
                cloud_silence=self._clouds.silence,
                transform=f"{frame}{' (extrinsics)' if settings.extrinsics is not None else ''}",
                job=job.what if job else "",
                last_outcome=self._last,
                latency=self._latency,
            )
        )


def main(factory: Factory = load_synthesizer) -> None:
    """Entry point of the executable `grasp_server`."""
    rclpy.init()
    node: GraspServer | None = None
    code = 0
    try:
        node = GraspServer(factory=factory)
        forward_logs(logging.getLogger("megrasp_core"), node.get_logger())
        forward_logs(logging.getLogger("megrasp_ros"), node.get_logger())
        node.start()
        executor = MultiThreadedExecutor(num_threads=6)
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (MegraspError, ParameterException) as error:
        rclpy.logging.get_logger("grasp_server").fatal(str(error))
        code = 2
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(code)


if __name__ == "__main__":
    main()

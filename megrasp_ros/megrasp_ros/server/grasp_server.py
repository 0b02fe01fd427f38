"""Node that turns point clouds into grasps: topics, services, action and parameters of
docs/ros.md, "ROS 2".

The node is thin. One worker thread computes (worker.py, engine.py, synthesis.py); no callback
waits in a thread of the executor, so that cancelling, parameters and diagnostics stay responsive.
Which gripper is on is known to tool_state.py alone.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from megrasp_msgs.msg import ErrorCode, GraspArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from megrasp_core.errors import InvalidRequestError
from megrasp_ros.errors import BinEmptyError, ConfigureError, NotActiveError, describe
from megrasp_ros.fast_dds import shared_memory_warning
from megrasp_ros.lifecycle import GuardedLifecycleNode
from megrasp_ros.logs import forward_logs
from megrasp_ros.memory import few_arenas
from megrasp_ros.process import StopSignals, run_node
from megrasp_ros.waiting import wake_when

from . import parameters
from .bin_service import BinService
from .diagnostics import diagnostics
from .engine import Engine, Factory, load_synthesizer
from .frames import FrameSource, TransformBuffer
from .grasp_messages import Outcome
from .gripper_services import GripperServices
from .gripper_shelf import GripperShelf
from .live_check import FindModel, LiveCheck, find_model
from .outputs import Outputs, Picture
from .parameter_table import FLANGE_PREFIX, TABLE
from .parameters import Settings
from .requests import ParsedRequest
from .sensing import Sensing
from .static_frames import StaticFrames
from .synthesis import OnStep, SynthesisRunner
from .synthesis_services import SynthesisServices
from .tool_state import Claim, ToolState
from .worker import Job, Worker

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

STOP = 30.0
"""Longest wait (s) for a job to stop when the node is deactivated."""

ANSWERS = 3.0
"""Longest wait (s) for requests to be answered when the node ends, and"""

SENDING = 0.5
"""time (s) for their answers to go out."""


class GraspServer(GuardedLifecycleNode):
    """Lifecycle node `grasp_server`."""

    def __init__(
        self,
        name: str = "grasp_server",
        *,
        factory: Factory = load_synthesizer,
        find: FindModel | None = None,
        buffer: TransformBuffer | None = None,
        **options: Any,
    ) -> None:
        """Make the node; it does nothing before its first transition, see `start`.

        Args:
            name: of the node.
            factory: makes the synthesizer.
            find: raises when the model of a name does not exist; by default the core's, for the
                core's synthesizer.
            buffer: replaces tf2's.
            options: those of rclpy's Node: namespace, context, parameter_overrides and so on.

        Raises:
            InvalidRequestError, ParameterException: a parameter's value is not usable.
        """
        super().__init__(name, **options)
        if find is None:
            find = find_model if factory is load_synthesizer else lambda model: None
        shelf = GripperShelf()
        self._live = LiveCheck(shelf, find)
        parameters.declare(self, self._live)
        group = ReentrantCallbackGroup()
        self._is_active = False
        self._error = ""
        self._not_configured: Exception | None = None
        self._engine = Engine(factory)
        self._worker = Worker()
        self._frames = FrameSource(self, buffer)
        self._sensing = Sensing(self, self._frames)
        self._synthesis = SynthesisRunner(self._engine, self._sensing)
        self._static_frames = StaticFrames(self)
        self._outputs = Outputs(
            self, lambda gripper: self._grippers.info(gripper), self._tell_frames
        )
        self._state = ToolState(self._outputs)
        self._grippers = GripperServices(
            self, self._engine, shelf, self._state, self._run_job, group
        )
        self._requests = SynthesisServices(
            self, self._worker, self._synthesize, self._require_active, self._ended, group
        )
        BinService(self, self._sensing, self._run_job, group)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        # Timers of the machine's clock: with use_sim_time the node's own may stand still.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(
            1.0, self._each_second, MutuallyExclusiveCallbackGroup(), clock=self._steady
        )
        self._starting: Timer | None = None
        self.add_post_set_parameters_callback(self._after_parameters)

    # Lifecycle

    def start(self) -> None:
        """Configure and activate as soon as the node is spun, if the parameter `autostart` says
        so. Services answer meanwhile that the node is not active.
        """
        if self.get_parameter("autostart").value and self._starting is None:
            self._starting = self.create_timer(
                0.01, self._autostart, MutuallyExclusiveCallbackGroup(), clock=self._steady
            )

    def _autostart(self) -> None:
        timer, self._starting = self._starting, None
        if timer is not None:
            self.destroy_timer(timer)
        if self.transition(Transition.TRANSITION_CONFIGURE):
            self.transition(Transition.TRANSITION_ACTIVATE)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load model and gripper. Fails, with the reason in the log, when one of them cannot be
        loaded or a parameter does not fit what there is.
        """
        started = time.monotonic()
        try:
            # In the worker, the import of torch included; services answer meanwhile.
            self._worker.submit(Job("configure", self._load)).wait()
        except Exception as error:
            self._not_configured, self._error = error, describe(error)[1]
            self.guard.tell("configuring failed", error)
            return TransitionCallbackReturn.FAILURE
        self._not_configured, self._error = None, ""
        active = self._state.active
        self.get_logger().info(
            f"model {self._engine.model_id!r} on {self._engine.device}, gripper "
            f"{active.name if active else None!r}, loaded in {time.monotonic() - started:.1f} s"
        )
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to answer requests."""
        settings = parameters.read(self)
        result = super().on_activate(state)
        self._is_active = True
        self._state.serve()
        self._frames.listen(settings)
        self._follow_points(settings)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take back the poses, cancel what runs and stop to answer requests."""
        self._stop_serving()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the model."""
        self._engine.unload()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take back the poses, cancel what runs."""
        self._stop_serving()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop to answer requests; the node can be configured again."""
        self._stop_serving()
        return super().on_error(state)

    def close(self) -> None:
        """Cancel what runs, wait until it is answered, end the worker thread. The node is of no
        use afterwards.
        """
        self._is_active = False
        self._state.suspend()
        goals, owed = self._requests.goals, self._requests.goals.owed()
        asked = bool(owed or self.guard.waiting)
        self._worker.close()
        end = time.monotonic() + ANSWERS
        while (self.guard.waiting or not goals.sent(owed)) and time.monotonic() < end:
            time.sleep(0.01)
        if asked:
            # What was handed to the middleware still has to reach the clients.
            time.sleep(SENDING)

    def destroy_node(self) -> None:
        """Destroy the action server, too."""
        self._requests.close()
        super().destroy_node()

    def _stop_serving(self) -> None:
        self._is_active = False
        # Before the publishers are switched off.
        self._state.suspend()
        self._sensing.rest()
        self._worker.stop_all(
            "the node is being deactivated; activate it and send the request again.", STOP
        )

    # Jobs

    def _load(self, job: Job) -> None:
        # Here and nowhere earlier: this is what takes seconds.
        import megrasp_core.synthesizer  # noqa: F401

        settings = parameters.read(self)
        parameters.declare_flanges(self, self._live)
        wrong = self._live.wrong(TABLE, {name: self.get_parameter(name).value for name in TABLE})
        # Grippers and model give the reason in their own words, below.
        if wrong and not wrong.startswith(("parameter gripper:", "parameter model:")):
            raise InvalidRequestError(wrong)
        self._engine.load_model(settings)
        self._grippers.configure(settings, job)
        active = self._state.active
        if active is not None:
            self._engine.use(active)

    def _require_active(self) -> None:
        if self._is_active:
            return
        if self._not_configured is not None:
            raise ConfigureError(self._not_configured)
        raise NotActiveError(
            "the lifecycle node is not active; expected the state `active`. Configure and "
            f"activate it: ros2 lifecycle set {self.get_fully_qualified_name()} configure, "
            "then activate; or start it with autostart: true, which takes a moment."
        )

    async def _run_job(
        self,
        what: str,
        work: Callable[[Job], Any],
        *,
        timeout: float = 0.0,
        preemptible: bool = False,
    ) -> Any:
        def checked(job: Job) -> Any:
            # Again: the node may have been deactivated before there was a job to cancel.
            self._require_active()
            return work(job)

        self._require_active()
        job = self._worker.submit(Job(what, checked, timeout, preemptible=preemptible))
        await self._ended(job)
        return job.outcome()

    async def _ended(self, job: Job) -> None:
        """Wait for the end of a job; the thread of the executor does something else meanwhile."""
        await wake_when(job.on_done, self)

    def _synthesize(
        self, job: Job, request: ParsedRequest, settings: Settings, on_step: OnStep | None
    ) -> Outcome:
        """Work of a synthesis job: compute, then publish."""
        # Again: the node may have been deactivated before there was a job to cancel.
        self._require_active()
        grippers, claim = self._grippers.chosen(request.gripper_name, settings, job)

        def step(phase: str, index: int, total: int, grasps: GraspArray | None) -> None:
            if claim is not None and len(grippers) == 1:
                # Nobody waits for grasps of a gripper that has gone.
                self._state.check(claim)
            if on_step is not None:
                on_step(phase, index, total, grasps)

        try:
            self._engine.load_model(settings)
            self._error = ""
            mounted = self._state.mounted
            computed = self._synthesis.run(job, request, settings, grippers, step, mounted=mounted)
        except BinEmptyError:
            if claim is not None:
                self._state.clear(claim)
            raise
        except Exception as error:
            if describe(error)[0] in (ErrorCode.MODEL_NOT_LOADED, ErrorCode.INTERNAL):
                self._error = describe(error)[1]
            raise
        if claim is not None and computed.gripper.name == claim.gripper.name:
            reference = self._grippers.gripper_from_reference(claim.gripper, settings)
            picture = Picture(computed.outcome.grasps, claim.gripper, computed.points)
            self._publish(claim, picture, reference)
        return computed.outcome

    def _publish(self, claim: Claim, picture: Picture, reference: Any) -> None:
        self._state.publish(claim, lambda: self._outputs.grasps(picture, reference))

    # Parameters and diagnostics

    def _after_parameters(self, changed: list[Parameter]) -> None:
        names = {parameter.name for parameter in changed}
        settings = parameters.read(self)
        if "gripper" in names:
            self._grippers.ask_for(settings.gripper)
        if {"auto_synthesize", "input", "points_subscription"} & names:
            self._follow_points(settings)
        if {"planning_frame", "extrinsics"} & names and self._is_active:
            self._frames.listen(settings)
        active = self._state.active
        told = any(name == "flange_frame" or name.startswith(FLANGE_PREFIX) for name in names)
        if told and active is not None and self._is_active:
            self._tell_frames(active)
        if self._not_configured is not None:
            # Perhaps this has mended what was wrong.
            self.start()

    def _tell_frames(self, gripper: Gripper) -> None:
        flange = str(self.get_parameter("flange_frame").value)
        self._static_frames.tell(gripper, parameters.flange_from_gripper(self, gripper), flange)

    def _follow_points(self, settings: Settings) -> None:
        automatic = settings.auto_synthesize == "on_cloud"
        self._sensing.follow(
            settings,
            continuous=self._is_active
            and (automatic or settings.points_subscription == "continuous"),
            on_arrival=self._requests.on_cloud if automatic else None,
        )

    def _each_second(self) -> None:
        self._outputs.show()
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        job, active = self._worker.current, self._state.active
        frame = self.get_parameter("planning_frame").value or "frame of the cloud"
        source = self._sensing.source(str(self.get_parameter("input").value))
        self._diagnostics.publish(
            diagnostics(
                name=self.get_fully_qualified_name(),
                stamp=self.get_clock().now().to_msg(),
                state="active" if self._is_active else "not active",
                error=self._error,
                gripper=active.name if active else "",
                reported=self._state.reported,
                tool_version=self._state.version,
                model=self._engine.model_id,
                device=self._engine.device,
                clouds=source.count,
                cloud_rate=source.rate,
                cloud_silence=source.silence,
                planning_frame=frame,
                transform=self._frames.last,
                transform_missing=self._frames.missing,
                job=job.what if job else "",
                last_outcome=self._requests.last,
                latency=self._requests.latency,
                topics=self._sensing.topics,
            )
        )


def main(factory: Factory = load_synthesizer, signals: StopSignals | None = None) -> None:
    """Entry point of the executable `grasp_server`."""

    def make() -> GraspServer:
        node = GraspServer(factory=factory)
        forward_logs(logging.getLogger("megrasp_core"), node.get_logger())
        forward_logs(logging.getLogger("megrasp_ros"), node.get_logger())
        small = shared_memory_warning()
        if small:
            node.get_logger().warning(small)
        return node

    few_arenas()
    run_node(make, threads=6, signals=signals)


if __name__ == "__main__":
    main()

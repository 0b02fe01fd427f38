"""Node that turns point clouds into grasps: topics, services, action and parameters of
docs/ros.md, "ROS 2".

The node is thin. One worker thread computes (worker.py, engine.py, synthesis.py); the executor's
threads only wait for it, so that cancelling, parameters and diagnostics stay responsive.
"""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from megrasp_msgs.msg import ErrorCode
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.parameter import Parameter

from megrasp_core.errors import MegraspError
from megrasp_core.grippers import Gripper
from megrasp_ros.errors import BinEmptyError, NotActiveError, describe
from megrasp_ros.logs import forward_logs
from megrasp_ros.spinning import spin

from . import parameters
from .clouds import CloudSource
from .diagnostics import diagnostics
from .engine import Engine, Factory, load_synthesizer
from .frames import FrameSource, TransformBuffer
from .grasp_messages import Outcome
from .gripper_services import GripperServices
from .outputs import Outputs
from .parameters import Settings
from .requests import ParsedRequest
from .synthesis import OnStep, SynthesisRunner
from .synthesis_services import SynthesisServices
from .worker import Job, Worker


class GraspServer(LifecycleNode):
    """Lifecycle node `grasp_server`. `factory` makes the synthesizer, `buffer` replaces tf2."""

    def __init__(
        self, *, factory: Factory = load_synthesizer, buffer: TransformBuffer | None = None
    ) -> None:
        super().__init__("grasp_server")
        parameters.declare(self)
        group = ReentrantCallbackGroup()
        self._is_active = False
        self._error = ""
        self._engine = Engine(factory)
        self._worker = Worker()
        self._clouds = CloudSource(self)
        self._synthesis = SynthesisRunner(self._engine, self._clouds, FrameSource(self, buffer))
        self._outputs = Outputs(self)
        self._grippers = GripperServices(
            self, self._engine, self._outputs, self._worker, self._run_job, group
        )
        self._requests = SynthesisServices(
            self, self._worker, self._synthesize, self._require_active, group
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.create_timer(
            1.0, self._publish_diagnostics, callback_group=MutuallyExclusiveCallbackGroup()
        )
        self.add_post_set_parameters_callback(self._after_parameters)

    # Lifecycle

    def start(self) -> None:
        """Configure and activate, if the parameter `autostart` says so."""
        if self.get_parameter("autostart").value:
            self.trigger_configure()
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load model and gripper. A failure is logged and answered to requests; the node keeps
        serving.
        """
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

    # Jobs

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
                "the lifecycle node is not active; expected the state `active`. Configure and "
                f"activate it: ros2 lifecycle set {self.get_fully_qualified_name()} configure, "
                "then activate; or start it with autostart: true."
            )

    def _run_job(self, what: str, work: Callable[[Job], Any]) -> Any:
        def checked(job: Job) -> Any:
            # Again: the node may have been deactivated before there was a job to cancel.
            self._require_active()
            return work(job)

        self._require_active()
        return self._worker.submit(Job(what, checked)).wait()

    def _synthesize(
        self, job: Job, request: ParsedRequest, settings: Settings, on_step: OnStep | None
    ) -> Outcome:
        """Work of a synthesis job: compute, then publish."""
        # Again: the node may have been deactivated before there was a job to cancel.
        self._require_active()
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

    # Parameters and diagnostics

    def _after_parameters(self, changed: list[Parameter]) -> None:
        if {"auto_synthesize", "points_subscription"} & {parameter.name for parameter in changed}:
            self._follow_points(parameters.read(self))

    def _follow_points(self, settings: Settings) -> None:
        automatic = settings.auto_synthesize == "on_cloud"
        self._clouds.on_cloud = self._requests.on_cloud if automatic else None
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
                last_outcome=self._requests.last,
                latency=self._requests.latency,
            )
        )


def main(factory: Factory = load_synthesizer) -> None:
    """Entry point of the executable `grasp_server`."""
    rclpy.init()
    nodes: list[GraspServer] = []
    code = _serve(factory, nodes)
    _join_callbacks(3.0)
    # After the callbacks, so that requests at work get their answer.
    while nodes:
        nodes.pop().destroy_node()
    rclpy.try_shutdown()
    # Fast DDS keeps its shared memory until the last object that knows the node is gone.
    gc.collect()
    # Freeing torch's modules takes seconds more on a busy machine, and ros2 launch loses patience
    # with a node after five.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _serve(factory: Factory, nodes: list[GraspServer]) -> int:
    """Run the node, which is put into `nodes`, until a signal; return the exit code."""
    executor = MultiThreadedExecutor(num_threads=6)
    try:
        node = GraspServer(factory=factory)
        nodes.append(node)
        forward_logs(logging.getLogger("megrasp_core"), node.get_logger())
        forward_logs(logging.getLogger("megrasp_ros"), node.get_logger())
        node.start()
        executor.add_node(node)
        spin(executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except (MegraspError, ParameterException) as error:
        get_logger("grasp_server").fatal(str(error))
        return 2
    finally:
        for node in nodes:
            node.close()
        executor.shutdown()
    return 0


def _join_callbacks(timeout: float) -> None:
    """Wait (s) for the executor's threads. Its own shutdown does not wait for them; they end once
    it is gone and they are done with their callbacks.
    """
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        gc.collect()
        busy = [
            thread
            for thread in threading.enumerate()
            if thread is not threading.main_thread() and not thread.daemon
        ]
        if not busy:
            return
        busy[0].join(0.05)


if __name__ == "__main__":
    main()

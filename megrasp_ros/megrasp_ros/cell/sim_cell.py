"""Node `sim_cell`: the robot cell, played in MuJoCo, behind the interfaces of a real cell.

Publishes `points` (PointCloud2, best effort, depth 1), `depth` and `camera_info`, each only while
somebody listens, `tool_id` (latched) and, if asked for, `/clock`. Serves `change_tool` and the
action `execute_grasp`. The simulation runs in one worker thread, so that services answer while a
grasp is executed.

Frames: `cell` is the world of the simulation, z up, origin on the bin's floor in its middle;
`cell_camera_optical_frame` is the camera's. Grasps are accepted in both.
"""

from __future__ import annotations

import concurrent.futures
import math
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from megrasp_msgs.action import ExecuteGrasp
from megrasp_msgs.srv import ChangeTool
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock as RclpyClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import String

from megrasp_core.cell.robot_cell import CellView, ExecutionResult, RobotCell
from megrasp_core.errors import CancelledError, InvalidRequestError
from megrasp_core.objects import load_objects
from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.errors import (
    BusyError,
    NotActiveError,
    StaleCloudError,
    ToolMismatchError,
    TransformError,
    describe,
    is_expected,
    shortened,
)
from megrasp_ros.process import StopSignals, run_node
from megrasp_ros.qos import LATCHED, SENSOR
from megrasp_ros.sensor_messages import camera_info_message, cloud_message, depth_message

from .parameters import CellParameters, declare_cell_parameters

CELL_FRAME = "cell"
CAMERA_FRAME = "cell_camera_optical_frame"

CLOCK_PERIOD = 0.02
STEADY = ClockType.STEADY_TIME

FUTURE_TOLERANCE = 1.0
"""A stamp may lie this far (s) ahead of the node's clock."""


class SimCell(Node):
    """The cell as a node. The services exist once the objects have settled, so wait for them."""

    def __init__(self, name: str = "sim_cell", **options: Any) -> None:
        """Make the node; `options` are those of rclpy's Node: namespace, context and so on."""
        super().__init__(name, **options)
        self._settings = declare_cell_parameters(self)
        self._cell = make_cell(self._settings)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="cell")
        self._executing = threading.Lock()
        self._publishing = False
        self._scene_changed = Time(clock_type=self.get_clock().clock_type)
        self._points = self.create_publisher(PointCloud2, "points", SENSOR)
        self._depth = self.create_publisher(Image, "depth", SENSOR)
        self._camera_info = self.create_publisher(CameraInfo, "camera_info", SENSOR)
        self._tool_id = self.create_publisher(String, "tool_id", LATCHED)
        self._report_tool()
        group = ReentrantCallbackGroup()
        self.create_timer(1.0 / self._settings.cloud_rate, self._tick, callback_group=group)
        self.create_service(ChangeTool, "change_tool", self._change_tool, callback_group=group)
        self._action = ActionServer(
            self,
            ExecuteGrasp,
            "execute_grasp",
            self._execute,
            callback_group=group,
            # Heard at the beginning of the next phase; the arm then goes back, and the scene is as
            # before.
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=60,
        )
        if self._settings.publish_clock:
            self._clock_topic = self.create_publisher(Clock, "/clock", 10)
            self.create_timer(
                CLOCK_PERIOD, self._tell_time, group, clock=RclpyClock(clock_type=STEADY)
            )
        self.get_logger().info(
            f"ready: {self._cell.objects_left} objects, rack {', '.join(self._cell.rack)}, "
            f"{self._cell.gripper.name} mounted"
        )

    def destroy_node(self) -> None:
        """Waits for the simulation step that is running, then lets go of the node."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._action.destroy()
        super().destroy_node()

    def _tell_time(self) -> None:
        # The machine's clock: the node's own may be the one that is told here.
        self._clock_topic.publish(Clock(clock=RclpyClock().now().to_msg()))

    # Camera

    def _tick(self) -> None:
        if not self.context.ok():
            return
        wanted = any(
            publisher.get_subscription_count()
            for publisher in (self._points, self._depth, self._camera_info)
        )
        # A picture taken while the arm is in the bin would show what is no longer there a moment
        # later.
        if wanted and not (self._publishing or self._executing.locked()):
            self._publishing = True
            self._worker.submit(self._publish_view)

    def _publish_view(self) -> None:
        try:
            stamp = self.get_clock().now().to_msg()
            view = self._cell.look()
            if self._points.get_subscription_count():
                self._points.publish(self._cloud(view, stamp))
            if self._depth.get_subscription_count():
                self._depth.publish(depth_message(view.depth, frame=CAMERA_FRAME, stamp=stamp))
            if self._camera_info.get_subscription_count():
                self._camera_info.publish(
                    camera_info_message(view.camera, frame=CAMERA_FRAME, stamp=stamp)
                )
        except Exception:
            # Ctrl-C makes the publishers invalid while a picture is on its way.
            if self.context.ok():
                self.get_logger().error(f"no picture: {traceback.format_exc()}")
        finally:
            self._publishing = False

    def _cloud(self, view: CellView, stamp: TimeMessage) -> PointCloud2:
        if self._settings.frame == "cell":
            return cloud_message(view.cloud.points, frame=CELL_FRAME, stamp=stamp)
        cloud = view.cloud.transformed(np.linalg.inv(view.camera.world_from_camera))
        return cloud_message(cloud.points, frame=CAMERA_FRAME, stamp=stamp)

    # Tool

    def _change_tool(
        self, request: ChangeTool.Request, response: ChangeTool.Response
    ) -> ChangeTool.Response:
        try:
            if not request.gripper_name:
                raise InvalidRequestError(
                    f"gripper_name is empty; expected one of {', '.join(self._cell.rack)}"
                )
            self._worker.submit(self._cell.change_tool, request.gripper_name).result()
            response.success = True
            self.get_logger().info(f"mounted {request.gripper_name}")
        except Exception as error:
            _, response.message = self._explain(error)
            self.get_logger().warning(f"tool not changed: {response.message}")
        response.mounted = self._cell.gripper.name
        self._report_tool()
        return response

    def _report_tool(self) -> None:
        self._tool_id.publish(String(data=self._cell.gripper.name))

    # Execution

    def _execute(self, handle: ServerGoalHandle) -> ExecuteGrasp.Result:
        goal: ExecuteGrasp.Goal = handle.request
        result = ExecuteGrasp.Result(objects_left=self._cell.objects_left, width=math.nan)
        try:
            outcome = self._attempt(goal, handle)
        except CancelledError as error:
            result.error_code, result.error_msg = self._explain(error)
            handle.canceled()
            self.get_logger().info("grasp cancelled; the scene is as before")
            return result
        except Exception as error:
            result.error_code, result.error_msg = self._explain(error)
        else:
            result.success = outcome.success
            result.removed = list(outcome.removed)
            result.error_msg = outcome.error
            if outcome.spilled:
                result.error_msg += f" (fell out of the bin: {', '.join(outcome.spilled)})"
            result.objects_left = outcome.objects_left
            result.width = outcome.width
            handle.succeed()
            self.get_logger().info(_report(outcome))
            return result
        self.get_logger().warning(f"grasp refused, error {result.error_code}: {result.error_msg}")
        handle.abort()
        return result

    def _attempt(self, goal: ExecuteGrasp.Goal, handle: ServerGoalHandle) -> ExecutionResult:
        if not self._executing.acquire(blocking=False):
            raise BusyError("another grasp is being executed; wait for its result")
        try:
            return self._worker.submit(self._attempt_in_worker, goal, handle).result()
        finally:
            self._executing.release()

    def _attempt_in_worker(
        self, goal: ExecuteGrasp.Goal, handle: ServerGoalHandle
    ) -> ExecutionResult:
        # In the worker, because a tool change that was queued before this goal decides whether it
        # fits.
        self._check_goal(goal)
        world_from_frame = self._world_from(goal.header.frame_id)
        pose = world_from_frame @ matrix_from_pose(goal.grasp.pregrasp, "grasp.pregrasp")
        approach = world_from_frame @ matrix_from_pose(goal.grasp.approach, "grasp.approach")
        opening = self._opening(goal.grasp.pregrasp_posture)

        def begin(phase: str) -> None:
            if handle.is_cancel_requested:
                raise CancelledError(f"the goal was cancelled before the phase {phase!r}")
            handle.publish_feedback(ExecuteGrasp.Feedback(phase=phase))

        outcome = self._cell.execute(pose, approach, opening, on_phase=begin)
        self._scene_changed = self.get_clock().now()
        return outcome

    def _opening(self, posture: JointState) -> float:
        """Share of the stroke at which the fingers start; fully open without a posture."""
        if not posture.name and not posture.position:
            return 0.0
        moving = self._cell.gripper.open_joints
        known = len(posture.name) == len(posture.position) and set(posture.name) <= set(moving)
        if not known or not np.isfinite(posture.position).all():
            raise InvalidRequestError(
                f"grasp.pregrasp_posture has the joints {shortened(str(posture.name), 200)} at "
                f"{shortened(str(list(posture.position)), 200)}; expected a finite position for "
                f"each of some joints of {self._cell.gripper.name}, {', '.join(moving)}, or none"
            )
        return self._cell.gripper.share_of(dict(zip(posture.name, posture.position, strict=True)))

    def _check_goal(self, goal: ExecuteGrasp.Goal) -> None:
        mounted = self._cell.gripper.name
        if goal.gripper != mounted:
            raise ToolMismatchError(
                f"the grasp is for {goal.gripper or '(no gripper named)'}, but {mounted} is "
                "mounted; call change_tool or synthesize for the mounted gripper",
            )
        stamp = Time.from_msg(goal.header.stamp, clock_type=self.get_clock().clock_type)
        if stamp.nanoseconds == 0:
            raise InvalidRequestError(
                "header.stamp is 0; expected the stamp of the cloud that the grasp was computed "
                "from",
            )
        if stamp <= self._scene_changed:
            raise StaleCloudError(
                "the grasp was computed from a cloud taken before the last attempt, which moved "
                "the objects; synthesize again with not_before set to the end of that attempt",
            )
        ahead = (stamp - self.get_clock().now()).nanoseconds * 1e-9
        if ahead > FUTURE_TOLERANCE:
            raise InvalidRequestError(
                f"header.stamp is {ahead:.1f} s in the future; check the clocks (use_sim_time) "
                "of the two nodes",
            )

    def _explain(self, error: Exception) -> tuple[int, str]:
        """Error code and text; what nobody expected leaves its traceback in the log."""
        if isinstance(error, concurrent.futures.CancelledError):
            error = NotActiveError("the cell is shutting down; start it again")
        if not is_expected(error):
            self.get_logger().error("".join(traceback.format_exception(error)))
        return describe(error)

    def _world_from(self, frame: str) -> np.ndarray:
        if frame == CELL_FRAME:
            return np.eye(4)
        if frame == CAMERA_FRAME:
            return self._cell.settings.camera.world_from_camera
        raise TransformError(
            f"header.frame_id is {frame!r}; expected {CELL_FRAME!r} or {CAMERA_FRAME!r}",
        )


def make_cell(parameters: CellParameters) -> RobotCell:
    """The cell that the parameters describe. Raises MegraspError."""
    mounted = parameters.gripper or None
    if not parameters.objects_dir:
        return RobotCell.procedural(
            parameters.num_objects, parameters.grippers, seed=parameters.seed, mounted=mounted
        )
    stock = load_objects(Path(parameters.objects_dir))
    if not stock:
        raise InvalidRequestError(
            f"objects_dir {parameters.objects_dir!r} holds no object; expected folders with a "
            "meta.json"
        )
    rng = np.random.default_rng(parameters.seed)
    chosen = rng.choice(
        len(stock), size=parameters.num_objects, replace=parameters.num_objects > len(stock)
    )
    return RobotCell(
        [stock[i] for i in chosen], parameters.grippers, seed=parameters.seed, mounted=mounted
    )


def _report(outcome: ExecutionResult) -> str:
    what = ", ".join(outcome.removed) or "nothing"
    how = "success" if outcome.success else f"failure ({outcome.error})"
    fingers = "" if math.isnan(outcome.width) else f", fingers at {1000 * outcome.width:.1f} mm"
    return f"{how}: removed {what}{fingers}; {outcome.objects_left} objects left"


def main(signals: StopSignals | None = None) -> None:
    """Entry point of the executable `sim_cell`."""
    run_node(SimCell, signals=signals)

"""The gripper side of grasp_server: which gripper is active, and the services that ask and change
that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from megrasp_msgs.msg import ErrorCode, GripperInfo
from megrasp_msgs.srv import ChangeTool, ListGrippers, ReloadGrippers, SetGripper
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter
from std_msgs.msg import String

from megrasp_core.errors import MegraspError, UnknownGripperError
from megrasp_core.grippers import Gripper
from megrasp_ros.errors import ToolChangeError, ToolMismatchError, describe
from megrasp_ros.qos import LATCHED
from megrasp_ros.waiting import wait_for_future

from . import parameters
from .engine import Engine
from .grasp_messages import gripper_info
from .outputs import Outputs
from .parameters import Settings
from .worker import Job, Worker

RunJob = Callable[[str, Callable[[Job], Any]], Any]
"""(what, work) -> result; runs the work in the worker thread of an active node."""
CHANGE_TOOL_TIMEOUT = 60.0


class GripperServices:
    """Serves set_gripper, list_grippers and reload_grippers, and listens to tool_id."""

    def __init__(
        self,
        node: LifecycleNode,
        engine: Engine,
        outputs: Outputs,
        worker: Worker,
        run_job: RunJob,
        group: CallbackGroup,
    ) -> None:
        self._node, self._engine, self._outputs, self._worker = node, engine, outputs, worker
        self._run_job = run_job
        self._group = group
        self._parameter = ""
        self.tool_id = ""
        node.create_subscription(
            String, "tool_id", self._on_tool_id, LATCHED, callback_group=group
        )
        node.create_service(SetGripper, "set_gripper", self._set_gripper, callback_group=group)
        node.create_service(
            ListGrippers, "list_grippers", self._list_grippers, callback_group=group
        )
        node.create_service(
            ReloadGrippers, "reload_grippers", self._reload_grippers, callback_group=group
        )

    def info(self, gripper: Gripper) -> GripperInfo:
        """Return the message of a gripper."""
        return gripper_info(gripper, seen_in_training=self._engine.seen_in_training(gripper))

    def follow_parameter(self, settings: Settings) -> None:
        """Make the gripper of the parameter `gripper` active if the parameter has changed or none
        is active.

        Raises UnknownGripperError or DescriptionError.
        """
        if self._engine.active is None or settings.gripper != self._parameter:
            gripper = self._engine.gripper(settings.gripper, settings)
            self._activate(gripper, settings.gripper)

    def publish_active(self) -> None:
        """Publish `active_gripper`, if there is one."""
        if self._engine.active is not None:
            self._outputs.active_gripper(self.info(self._engine.active), self._engine.active)

    def chosen(self, name: str, settings: Settings) -> list[Gripper]:
        """Return the grippers a request with this gripper_name is computed for; the worker calls
        this.

        Raises UnknownGripperError, DescriptionError, and ToolMismatchError when the active gripper
        is not the one that tool_id reports.
        """
        if name == "auto":
            names = settings.rack
            if names:
                return [self._engine.gripper(each, settings) for each in names]
        elif name:
            gripper = self._engine.gripper(name, settings)
            if self._engine.active is None or gripper.name != self._engine.active.name:
                return [gripper]
        self.follow_parameter(settings)
        active = self._engine.active
        assert active is not None, "follow_parameter activates a gripper or raises"
        if self.tool_id and self.tool_id != active.name:
            raise ToolMismatchError(
                f"tool_id reports {self.tool_id!r}, but the active gripper is {active.name!r}; "
                f"expected the same. Call set_gripper with {self.tool_id!r}, or mount "
                f"{active.name!r}."
            )
        return [active]

    def gripper_from_reference(
        self, gripper: Gripper, settings: Settings
    ) -> NDArray[np.float64] | None:
        """Return the pose (4, 4), in the gripper frame, of the frame that `pose_reference` names;
        None: itself.
        """
        if settings.pose_reference == "tcp":
            return gripper.gripper_from_tcp
        if settings.pose_reference == "flange":
            flange = parameters.flange_from_gripper(self._node, gripper)
            return np.asarray(np.linalg.inv(flange), np.float64)
        return None

    def _activate(self, gripper: Gripper, parameter: str) -> None:
        self._engine.use(gripper)
        self._engine.active = gripper
        self._parameter = parameter
        self._outputs.nothing()
        self.publish_active()

    def _on_tool_id(self, message: String) -> None:
        self.tool_id = message.data

    def _set_gripper(
        self, request: SetGripper.Request, response: SetGripper.Response
    ) -> SetGripper.Response:
        settings = parameters.read(self._node)
        response.available = self._engine.available(settings)
        try:
            response.gripper = self._run_job(
                f"set_gripper {request.gripper_name!r}",
                lambda job: self._change(request, settings),
            )
        except Exception as error:
            response.error_code, response.error_msg = describe(error)
            self._node.get_logger().warning(f"set_gripper: {response.error_msg}")
            return response
        response.success = True
        state = "could be active (dry run)" if request.dry_run else "is active"
        self._node.get_logger().info(f"gripper {response.gripper.name!r} {state}")
        return response

    def _change(self, request: SetGripper.Request, settings: Settings) -> GripperInfo:
        if not request.gripper_name:
            raise UnknownGripperError("", self._engine.available(settings))
        gripper = self._engine.gripper(request.gripper_name, settings)
        # Renders the gripper: what can fail has failed before anything changes.
        gripper.tokens()
        if request.dry_run:
            return self.info(gripper)
        if settings.tool_changer:
            self._change_tool(settings.tool_changer, gripper.name)
        self._activate(gripper, request.gripper_name)
        self._node.set_parameters([Parameter("gripper", value=request.gripper_name)])
        return self.info(gripper)

    def _change_tool(self, service: str, name: str) -> None:
        client = self._node.create_client(ChangeTool, service, callback_group=self._group)
        try:
            if not client.wait_for_service(timeout_sec=10.0):
                raise ToolChangeError(
                    f"no service {service!r} after 10 s; expected the tool changer. Start it, or "
                    "set the parameter tool_changer to the name of its ChangeTool service."
                )
            answer = wait_for_future(
                client.call_async(ChangeTool.Request(gripper_name=name)), CHANGE_TOOL_TIMEOUT
            )
            if answer is None or not answer.success:
                why = (
                    f"no answer within {CHANGE_TOOL_TIMEOUT:g} s"
                    if answer is None
                    else answer.message
                )
                raise ToolChangeError(
                    f"the tool changer did not mount {name!r}: {why}. Check the changer; the "
                    "active gripper is unchanged here."
                )
            self.tool_id = answer.mounted or self.tool_id
        finally:
            self._node.destroy_client(client)

    def _list_grippers(
        self, _: ListGrippers.Request, response: ListGrippers.Response
    ) -> ListGrippers.Response:
        settings = parameters.read(self._node)
        active = self._engine.active
        response.active = "" if active is None else active.name
        for name in self._engine.available(settings):
            try:
                response.grippers.append(self.info(self._engine.gripper(name, settings)))
            except MegraspError as error:
                self._node.get_logger().warning(f"list_grippers leaves out {name!r}: {error}")
        return response

    def _reload_grippers(
        self, _: ReloadGrippers.Request, response: ReloadGrippers.Response
    ) -> ReloadGrippers.Response:
        settings = parameters.read(self._node)
        try:
            response.failed = self._run_job("reload_grippers", lambda job: self._reload(settings))
        except Exception as error:
            response.error_code, response.error_msg = describe(error)
        else:
            response.success = not response.failed
            if response.failed:
                response.error_code = ErrorCode.BAD_DESCRIPTION
                response.error_msg = (
                    f"{len(response.failed)} description(s) cannot be read; see `failed`."
                )
        response.available = self._engine.available(settings)
        return response

    def _reload(self, settings: Settings) -> list[str]:
        self._engine.forget_grippers()
        failed = []
        for name in self._engine.available(settings):
            try:
                self._engine.gripper(name, settings)
            except MegraspError as error:
                failed.append(f"{name}: {error}")
        active = self._engine.active
        if active is not None and self._parameter:
            try:
                fresh = self._engine.gripper(self._parameter, settings)
            except MegraspError:
                return failed
            if fresh.hash != active.hash:
                self._activate(fresh, self._parameter)
        return failed

"""The gripper side of grasp_server: the services that ask and change which gripper is on, and
`tool_id`.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from megrasp_msgs.msg import ErrorCode, GripperInfo
from megrasp_msgs.srv import ListGrippers, ReloadGrippers, SetGripper
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.parameter import Parameter
from std_msgs.msg import String

from megrasp_core.errors import MegraspError
from megrasp_ros.errors import (
    NotActiveError,
    ToolMismatchError,
    UnknownNameError,
    describe,
    shortened,
)
from megrasp_ros.lifecycle import GuardedLifecycleNode
from megrasp_ros.memory import give_back
from megrasp_ros.pacing import paced
from megrasp_ros.qos import CALLS, LATCHED
from megrasp_ros.waiting import wake_when

from . import parameters
from .changer import Changer
from .engine import Engine
from .grasp_messages import gripper_info
from .gripper_shelf import GripperShelf
from .parameters import Settings
from .tool_change import change_tool
from .tool_state import Claim, ToolState
from .worker import Job, run_job

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

RunJob = Callable[[str, Callable[[Job], Any]], Awaitable[Any]]
"""(what, work) -> result; runs the work in the worker thread of an active node."""

LISTING = 20.0
"""Longest time (s) for loading one gripper of a list."""


class GripperServices:
    """Serves set_gripper, list_grippers and reload_grippers, and listens to tool_id."""

    def __init__(
        self,
        node: GuardedLifecycleNode,
        engine: Engine,
        shelf: GripperShelf,
        state: ToolState,
        run_job: RunJob,
        group: CallbackGroup,
    ) -> None:
        self._node, self._engine, self._shelf, self._state = node, engine, shelf, state
        self._run_job = run_job
        self._changer = Changer(node)
        self._wanted = ""
        self._listed: Job | None = None
        self._lock = threading.Lock()
        node.create_subscription(
            String, "tool_id", self._on_tool_id, LATCHED, callback_group=group
        )
        services: dict[str, tuple[type, Callable[..., Any]]] = {
            "set_gripper": (SetGripper, self._set_gripper),
            "list_grippers": (ListGrippers, self._list_grippers),
            "reload_grippers": (ReloadGrippers, self._reload_grippers),
        }
        for name, (kind, callback) in services.items():
            node.create_service(
                kind, name, paced(callback, node), callback_group=group, qos_profile=CALLS
            )

    # What the other parts of the node ask

    def info(self, gripper: Gripper) -> GripperInfo:
        """Return the message of a gripper."""
        return gripper_info(gripper, seen_in_training=self._engine.seen_in_training(gripper))

    def ask_for(self, name: str) -> None:
        """Note a new value of the parameter `gripper`; it takes effect with the next request."""
        self._wanted = name if name != self._state.spelling else ""

    def configure(self, settings: Settings, job: Job) -> None:
        """Make the gripper of the parameter active if it is another one, or none is.

        Raises UnknownNameError or DescriptionError.
        """
        if self._state.active is None or settings.gripper != self._state.spelling:
            self._make_active(settings.gripper, settings, job)

    def chosen(
        self, name: str, settings: Settings, job: Job
    ) -> tuple[list[Gripper], Claim | None]:
        """Return the grippers that a request is computed for, and the claim to publish for the
        active one, if it is among them; the worker calls this.

        Raises UnknownNameError, DescriptionError, and ToolMismatchError when the active gripper is
        asked for and another tool is reported.
        """
        self._follow(settings, job)
        active = self._state.active
        if name == "auto" and settings.rack:
            rack = [self._load(each, settings, job, allow_paths=True) for each in settings.rack]
            return rack, self._claim_among(rack)
        if name and name != "auto":
            gripper = self._load(name, settings, job, allow_paths=settings.allow_paths)
            if active is None or gripper.name != active.name:
                return [gripper], None
        claim = self._state.claim()
        return [claim.gripper], claim

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

    def _claim_among(self, rack: list[Gripper]) -> Claim | None:
        try:
            claim = self._state.claim()
        except ToolMismatchError:
            # What is computed for another tool is answered all the same.
            return None
        return claim if any(each.name == claim.gripper.name for each in rack) else None

    def _follow(self, settings: Settings, job: Job) -> None:
        wanted = self._wanted
        if wanted:
            self._make_active(wanted, settings, job)
            if self._wanted == wanted:
                self._wanted = ""

    def _make_active(self, name: str, settings: Settings, job: Job) -> None:
        gripper = self._load(name, settings, job, allow_paths=True)
        change_tool(self._state, gripper, name, job, prepare=self._prepare, mount=None)

    def _load(self, name: str, settings: Settings, job: Job, *, allow_paths: bool) -> Gripper:
        return self._shelf.load(
            name, settings.gripper_paths, allow_paths=allow_paths, check=job.check
        )

    def _prepare(self, gripper: Gripper) -> None:
        # Rendered and encoded: what can fail has failed before anything changes.
        gripper.tokens()
        self._engine.use(gripper)
        parameters.declare_flange(self._node, gripper.name)

    # Callbacks

    def _on_tool_id(self, message: String) -> None:
        self._state.report(message.data)

    async def _set_gripper(
        self, request: SetGripper.Request, response: SetGripper.Response
    ) -> SetGripper.Response:
        name = request.gripper_name
        try:
            response.gripper, response.available = await self._run_job(
                f"set_gripper {shortened(name, 40)!r}",
                lambda job: self._change(name, request.dry_run, job),
            )
        except Exception as error:
            response.available = self._names(error)
            response.error_code, response.error_msg = describe(error)
            self._node.get_logger().warning(f"set_gripper: {response.error_msg}")
            return response
        response.success = True
        state = "could be active (dry run)" if request.dry_run else "is active"
        self._node.get_logger().info(f"gripper {response.gripper.name!r} {state}")
        return response

    def _names(self, error: Exception) -> list[str]:
        """Return the names that could have been asked for, where an error leaves time to look."""
        if isinstance(error, NotActiveError):
            # What is needed to look may still be loading.
            return []
        try:
            return self._shelf.names(parameters.read(self._node).gripper_paths)
        except MegraspError:
            return []

    def _change(self, name: str, dry_run: bool, job: Job) -> tuple[GripperInfo, list[str]]:
        settings = parameters.read(self._node)
        names = self._shelf.names(settings.gripper_paths)
        if not name:
            raise UnknownNameError("", names, allow_paths=settings.allow_paths)
        gripper = self._load(name, settings, job, allow_paths=settings.allow_paths)
        if dry_run:
            gripper.tokens()
            return self.info(gripper), names
        changer = settings.tool_changer
        change_tool(
            self._state,
            gripper,
            name,
            job,
            prepare=self._prepare,
            mount=(lambda tool, job: self._changer.mount(changer, tool, job)) if changer else None,
        )
        self._node.set_parameters([Parameter("gripper", value=name)])
        return self.info(gripper), names

    async def _list_grippers(
        self, _: ListGrippers.Request, response: ListGrippers.Response
    ) -> ListGrippers.Response:
        job = self._listing()
        await wake_when(job.on_done, self._node)
        active = self._state.active
        response.active = "" if active is None else active.name
        response.grippers = job.outcome()
        return response

    def _listing(self) -> Job:
        """Return the list that is being made, or begin another.

        In a thread of its own: it may be asked for while the worker computes, and the first one
        takes seconds, for which no thread of the executor waits.
        """
        with self._lock:
            if self._listed is None or self._listed.done.is_set():
                self._listed = job = Job("list_grippers", self._list)
                threading.Thread(target=run_job, args=(job,), name="listing", daemon=True).start()
            return self._listed

    def _list(self, _: Job) -> list[GripperInfo]:
        paths = parameters.read(self._node).gripper_paths
        log, found = self._node.get_logger(), []
        try:
            names = self._shelf.names(paths)
        except MegraspError as error:
            log.warning(f"list_grippers: {error}")
            return []
        for name in names:
            try:
                found.append(self.info(self._shelf.load(name, paths, seconds=LISTING)))
            except MegraspError as error:
                log.warning(f"list_grippers leaves out {name!r}: {error}")
        return found

    async def _reload_grippers(
        self, _: ReloadGrippers.Request, response: ReloadGrippers.Response
    ) -> ReloadGrippers.Response:
        try:
            response.failed, response.available = await self._run_job(
                "reload_grippers", self._reload
            )
        except Exception as error:
            response.error_code, response.error_msg = describe(error)
            self._node.get_logger().warning(f"reload_grippers: {response.error_msg}")
            return response
        response.success = not response.failed
        if response.failed:
            response.error_code = ErrorCode.BAD_DESCRIPTION
            response.error_msg = (
                f"{len(response.failed)} description(s) cannot be read; see `failed`."
            )
        return response

    def _reload(self, job: Job) -> tuple[list[str], list[str]]:
        try:
            return self._read_again(job)
        finally:
            give_back()

    def _read_again(self, job: Job) -> tuple[list[str], list[str]]:
        """Return what cannot be read, with the reasons, and all names."""
        settings = parameters.read(self._node)
        self._shelf.forget()
        failed = []
        names = self._shelf.names(settings.gripper_paths)
        for name in names:
            try:
                self._load(name, settings, job, allow_paths=False)
                parameters.declare_flange(self._node, name)
            except MegraspError as error:
                job.check()
                failed.append(f"{name}: {describe(error)[1]}")
        active, spelling = self._state.active, self._state.spelling
        if active is not None:
            try:
                fresh = self._load(spelling, settings, job, allow_paths=True)
            except MegraspError:
                return failed, names
            if fresh.hash != active.hash:
                self._prepare(fresh)
                self._state.commit(fresh, spelling, mounted=self._state.reported)
        return failed, names

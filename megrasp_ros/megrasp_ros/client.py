"""The grasp server from a Python program, as blocking calls.

For example, in a program that has no node of its own::

    with GraspClient.open() as client:
        client.wait_until_ready(30.0)
        client.set_gripper("franka_hand")
        for grasp in client.synthesize(num_grasps=20).grasps.grasps:
            ...

and in one that has, whose executor spins in another thread::

    client = GraspClient(node)
    result = client.generate(20, on_feedback=lambda f: print(f.phase, f.step, f.total_steps))
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import Vector3
from lifecycle_msgs.srv import GetState
from megrasp_msgs.action import ExecuteGrasp, GenerateGrasps
from megrasp_msgs.msg import ErrorCode, Grasp, GraspArray, GripperInfo
from megrasp_msgs.srv import (
    ChangeTool,
    DetectBin,
    ListGrippers,
    ReloadGrippers,
    SetGripper,
    SynthesizeGrasps,
)
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import PointCloud2

from .calling import Caller, CloudListener, GraspServerError
from .qos import LATCHED
from .spinning import spin

if TYPE_CHECKING:
    from megrasp_core.storage import AttemptFolder

LOADING = 0.3
"""Time between two questions to a server that is not active yet (s)."""
TELLS = 2.0
"""A server whose services are there tells its state within this time (s)."""
IDLE = 4
"""One that has been unconfigured for so many of them may have failed to be configured."""

OnFeedback = Callable[[GenerateGrasps.Feedback], None]

__all__ = ["GraspClient", "GraspServerError", "OnFeedback"]


class GraspClient:
    """Calls of a grasp_server, and of a cell that offers `change_tool` and `execute_grasp`.

    A thread other than the caller's must spin the node, best with a SingleThreadedExecutor:
    requests are sent by the executor (waiting.send_in_executor says why). Every method raises
    GraspServerError, and ExternalShutdownException when rclpy is shut down meanwhile.

    Attributes:
        grasps: the newest message of the topic `grasps`, None before the first.
        active_gripper: that of `active_gripper`.
    """

    def __init__(
        self,
        node: Node,
        *,
        namespace: str = "",
        server: str = "grasp_server",
        timeout: float = 60.0,
        record: AttemptFolder | str | Path | None = None,
    ) -> None:
        """Listen to the latched topics; everything else is made when it is used.

        Args:
            node: that another thread spins.
            namespace: of the server where it is not that of the node.
            server: name of its node, for `state` and `parameters`.
            timeout: longest wait (s) for a service to appear, and for an answer.
            record: folder that every attempt of `execute` is written to (see `record`).
        """
        prefix = f"{namespace.rstrip('/')}/" if namespace else ""
        self._caller = Caller(node, prefix, timeout)
        self._server = server
        self._clouds: CloudListener | None = None
        self.grasps: GraspArray | None = None
        self.active_gripper: GripperInfo | None = None
        for kind, topic in ((GraspArray, "grasps"), (GripperInfo, "active_gripper")):
            node.create_subscription(
                kind,
                prefix + topic,
                lambda message, topic=topic: setattr(self, topic, message),
                LATCHED,
                callback_group=self._caller.group,
            )
        self._recorder = None
        if record is not None:
            # Brings the whole core, which only those who record wait for.
            from .recording import AttemptRecorder

            self._recorder = AttemptRecorder(self, node, record)

    @classmethod
    @contextlib.contextmanager
    def open(
        cls,
        name: str = "grasp_client",
        *,
        namespace: str = "",
        context: Context | None = None,
        domain_id: int | None = None,
        **options: Any,
    ) -> Iterator[GraspClient]:
        """Yield a client with a node of its own and a thread that spins it.

        Args:
            name: of the node.
            namespace: of node and server.
            context: of rclpy, already initialised; None: one that lives as long as the client.
            domain_id: of that one; None: ROS_DOMAIN_ID.
            options: those of GraspClient.
        """
        used = Context() if context is None else context
        if context is None:
            rclpy.init(context=used, domain_id=domain_id)
        node = Node(name, namespace=namespace or None, context=used)
        executor = SingleThreadedExecutor(context=used)
        executor.add_node(node)

        def run() -> None:
            with contextlib.suppress(ExternalShutdownException):
                spin(executor)

        thread = threading.Thread(target=run, name="spin", daemon=True)
        thread.start()
        try:
            yield cls(node, **options)
        finally:
            executor.shutdown()
            thread.join(timeout=5.0)
            # A Ctrl-C amid rclpy's own bookkeeping leaves it a list that lacks an entry.
            with contextlib.suppress(ValueError):
                node.destroy_node()
            if context is None:
                used.try_shutdown()

    @property
    def node(self) -> Node:
        """The node that the calls go through."""
        return self._caller.node

    # The server

    def wait_until_ready(self, timeout: float, *, cell: bool = False) -> None:
        """Wait until the server is active, `timeout` seconds in all: it offers its services before
        it has loaded its model, and answers NOT_ACTIVE meanwhile. Where configuring it failed, the
        reason is raised.

        cell: wait for `change_tool` and `execute_grasp` as well.
        """
        end = time.monotonic() + timeout
        caller = self._caller
        services = [
            (SynthesizeGrasps, "synthesize_grasps", "grasp_server"),
            (SetGripper, "set_gripper", "grasp_server"),
        ]
        if cell:
            services.append((ChangeTool, "change_tool", "the cell"))
        for kind, name, whose in services:
            client = caller.service(kind, name)
            what = f"service {caller.full_name(name)} ({whose})"
            left = end - time.monotonic()
            caller.appear(what, client.wait_for_service, timeout, left=left)
        if cell:
            execute = caller.action(ExecuteGrasp, "execute_grasp")
            what = "action execute_grasp (the cell)"
            left = end - time.monotonic()
            caller.appear(what, execute.wait_for_server, timeout, left=left)
        # Every request that it refuses is a warning in its log, so the state is asked for, where a
        # node of that name tells it.
        states = caller.service(GetState, f"{self._server}/get_state")
        tells = states.wait_for_service(timeout_sec=max(0.01, min(TELLS, end - time.monotonic())))
        idle = 0
        while (state := self.state() if tells else "unknown") != "active":
            over = time.monotonic() >= end
            idle = idle + 1 if state == "unconfigured" else 0
            if (over or idle == IDLE or not tells) and self._serves(over=over, tells=tells):
                return
            time.sleep(min(LOADING, max(0.0, end - time.monotonic())))

    def synthesize(self, num_grasps: int = 20, **fields: Any) -> SynthesizeGrasps.Response:
        """Grasps, best first, with what was rejected and the times.

        Args:
            num_grasps: most to return.
            fields: further fields of SynthesizeGrasps.srv by their names.
        """
        request = SynthesizeGrasps.Request(num_grasps=num_grasps, **self._filled(fields))
        return self._caller.call(SynthesizeGrasps, "synthesize_grasps", request)

    def generate(
        self,
        num_grasps: int = 20,
        *,
        on_feedback: OnFeedback | None = None,
        cancelled: Callable[[], bool] | None = None,
        **fields: Any,
    ) -> GenerateGrasps.Result:
        """The same by the action, which can be watched and cancelled.

        Args:
            num_grasps: most to return.
            on_feedback: called in the executor's thread with every step; its `grasps` are the
                poses so far, unfinished and unchecked. What it raises ends the call.
            cancelled: asked some times a second; once it is true the goal is cancelled.
            fields: further fields of GenerateGrasps.action by their names.

        Returns:
            The result; of a goal that `cancelled` ended with error_code 3 and what there was.
        """
        goal = GenerateGrasps.Goal(num_grasps=num_grasps, **self._filled(fields))
        result, ended = self._caller.act(
            GenerateGrasps,
            "generate_grasps",
            goal,
            on_feedback=on_feedback,
            cancelled=cancelled,
        )
        if result.error_code and not (ended and result.error_code == ErrorCode.CANCELLED):
            raise GraspServerError(result.error_code, result.error_msg, result)
        return result

    def set_gripper(self, name: str, *, dry_run: bool = False) -> GripperInfo:
        """Make a gripper the active one, or only check that it could be."""
        request = SetGripper.Request(gripper_name=name, dry_run=dry_run)
        return self._caller.call(SetGripper, "set_gripper", request).gripper

    def list_grippers(self) -> ListGrippers.Response:
        """The registered grippers and which is active."""
        return self._caller.call(ListGrippers, "list_grippers", ListGrippers.Request())

    def grippers(self) -> dict[str, GripperInfo]:
        """Name -> description of the registered grippers."""
        return {info.name: info for info in self.list_grippers().grippers}

    def reload_grippers(self) -> ReloadGrippers.Response:
        """Let the server read its gripper folders again."""
        return self._caller.call(ReloadGrippers, "reload_grippers", ReloadGrippers.Request())

    def detect_bin(
        self,
        size: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        cloud: PointCloud2 | None = None,
    ) -> DetectBin.Response:
        """Where the bin is and how full; its `bin` is what `region` of a request takes.

        Args:
            size: inner edges of the bin (m), where they are known.
            cloud: to look at; None: the latest on `points`.
        """
        x, y, z = map(float, size)
        request = DetectBin.Request(size=Vector3(x=x, y=y, z=z))
        if cloud is not None:
            request.cloud = cloud
        return self._caller.call(DetectBin, "detect_bin", request)

    def wait_for_grasps(self, timeout: float, *, after: GraspArray | None = None) -> GraspArray:
        """The newest message of `grasps` that holds any and is another one than `after`."""

        def newest() -> GraspArray | None:
            grasps = self.grasps
            return None if grasps is None or grasps is after or not grasps.grasps else grasps

        found = self._caller.until(newest, timeout)
        if found is None:
            raise GraspServerError(
                0,
                f"no grasps were published within {timeout:g} s; ask for some, or set the "
                "server's parameter auto_synthesize",
            )
        return found

    def state(self) -> str:
        """State of the lifecycle node: unconfigured, inactive, active .."""
        answer = self._caller.call(GetState, f"{self._server}/get_state", GetState.Request())
        return answer.current_state.label

    def parameters(self, names: Iterable[str]) -> dict[str, Any]:
        """Values of the server's parameters; those that it does not have are left out."""
        names = list(names)
        request = GetParameters.Request(names=names)
        values = self._caller.call(GetParameters, f"{self._server}/get_parameters", request).values
        if len(values) == len(names):
            return dict(zip(names, map(parameter_value_to_python, values), strict=True))
        # rclpy answers nothing at all where it does not have one of them.
        one_by_one = [self.parameters([name]) for name in names] if len(names) > 1 else []
        return {name: value for found in one_by_one for name, value in found.items()}

    # The cell

    def newest_cloud(self, timeout: float, *, after: TimeMessage | None = None) -> PointCloud2:
        """The newest cloud on `points` with a stamp later than `after`, or without that the next
        one to come. The topic is subscribed to from the first call on.
        """
        if self._clouds is None:
            self._clouds = CloudListener(self._caller)
        return self._clouds.newest(timeout, after)

    def change_tool(self, name: str) -> ChangeTool.Response:
        """Let the tool changer mount a gripper."""
        request = ChangeTool.Request(gripper_name=name)
        return self._caller.call(ChangeTool, "change_tool", request)

    def execute(self, grasps: GraspArray, grasp: Grasp) -> ExecuteGrasp.Result:
        """Let the cell try one of `grasps`; what became of it is in the result, whose error_code
        says whether it was tried. Recorded, where the client records.
        """
        goal = ExecuteGrasp.Goal(header=grasps.header, gripper=grasps.gripper, grasp=grasp)
        result, _ = self._caller.act(ExecuteGrasp, "execute_grasp", goal)
        if self._recorder is not None and result.error_code == ErrorCode.NONE:
            self.record(grasps, grasp, success=result.success, reason=result.error_msg)
        return result

    def record(
        self,
        grasps: GraspArray,
        grasp: Grasp,
        *,
        success: bool,
        reason: str = "",
        **extra: Any,
    ) -> Path | None:
        """Write an attempt that somebody else executed; `execute` does it by itself.

        Where it cannot be written (the disk is full, the cloud is not known), the log says so and
        the cell goes on.

        Args:
            grasps: the last answer of this client.
            grasp: one of them.
            success: an object was taken.
            reason: why not.
            extra: whatever else is worth keeping; plain values.

        Returns:
            The file, None where there is none.

        Raises:
            ValueError: the client was made without `record`.
        """
        if self._recorder is None:
            raise ValueError("record was called; expected a client made with record=FOLDER.")
        return self._recorder.keep(grasps, grasp, success=success, reason=reason, extra=extra)

    def _serves(self, *, over: bool, tells: bool) -> bool:
        """Whether the server answers otherwise than that it is not active. Raised is that
        configuring it failed, where it `tells` its state, and every answer when time is `over`.
        """
        try:
            # Nothing is changed by a dry run, whatever the name.
            self.set_gripper("", dry_run=True)
        except GraspServerError as error:
            if error.code == ErrorCode.NONE or (over and error.code == ErrorCode.NOT_ACTIVE):
                raise
            if error.code == ErrorCode.NOT_ACTIVE:
                return False
            # An active one refuses the empty name.
            if tells and self.state() != "active":
                raise
        return True

    def _filled(self, fields: dict[str, Any]) -> dict[str, Any]:
        timeout = self._caller.timeout
        # The server's own timeout would otherwise end a slow machine's synthesis earlier.
        fields = {"timeout": 0.9 * timeout, **fields}
        if self._recorder is not None:
            if "cloud" not in fields:
                # So that the very cloud is there to be recorded.
                fields["cloud"] = self.newest_cloud(timeout, after=fields.get("not_before"))
            self._recorder.asked(fields["cloud"], fields.get("region"))
        return fields

"""A fault in any callback is answered and logged, and the node goes on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import server_double
from cell_processes import in_executor, own_domain, result, until
from lifecycle_msgs.srv import GetState
from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ListGrippers, SynthesizeGrasps
from rcl_interfaces.srv import ListParameters, SetParameters, SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from server_client import cloud_message, stamped_cloud, table_points
from std_msgs.msg import String

from megrasp_ros.guard import Guard
from megrasp_ros.qos import LATCHED, SENSOR
from megrasp_ros.server.grasp_server import GraspServer
from megrasp_ros.spinning import spin

FAULT = "a fault that somebody put here"


class Faulty(GraspServer):
    """A server that fails in the callbacks named in `failing`, below the guard."""

    def __init__(self, **options: Any) -> None:
        self.failing: set[str] = set()
        self.failed: dict[str, int] = {}
        self.callbacks: list[str] = []
        super().__init__(**options)

    def fail(self, name: str) -> None:
        if name in self.failing:
            self.failed[name] = self.failed.get(name, 0) + 1
            raise RuntimeError(FAULT)

    def faulty(self, name: str, callback: Any) -> Any:
        self.callbacks.append(name)

        def call(*arguments: Any) -> Any:
            self.fail(name)
            return callback(*arguments)

        return call

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        if srv_name in (*REFUSED, "list_grippers"):

            async def call(request: Any, response: Any) -> Any:
                self.fail(srv_name)
                return await callback(request, response)

            self.callbacks.append(srv_name)
            return super().create_service(srv_type, srv_name, call, **options)
        wrapped = self.faulty(srv_name, callback)
        return super().create_service(srv_type, srv_name, wrapped, **options)

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, *rest: Any, **options):
        name = f"subscription of {topic}"

        def call(message: Any) -> None:
            self.fail(name)
            callback(message)

        self.callbacks.append(name)
        return super().create_subscription(msg_type, topic, call, *rest, **options)

    def create_timer(self, period: float, callback: Any, *rest: Any, **options: Any) -> Any:
        name = f"timer {callback.__name__}"
        return super().create_timer(period, self.faulty(name, callback), *rest, **options)


class Pair:
    """A faulty server and a client's node, in one process."""

    def __init__(self, server: Faulty, node: Node) -> None:
        self.server, self.node = server, node
        self.clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        if name not in self.clients:
            self.clients[name] = self.node.create_client(kind, name)
            assert self.clients[name].wait_for_service(timeout_sec=60.0)
        client = self.clients[name]
        asked = request if request is not None else kind.Request()
        return result(in_executor(self.node, lambda: client.call_async(asked)))

    def synthesize(self, **fields: Any) -> Any:
        cloud = stamped_cloud(self.node, table_points())
        request = SynthesizeGrasps.Request(num_grasps=1, cloud=cloud, **fields)
        return self.call(SynthesizeGrasps, "synthesize_grasps", request)


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain(6))
    overrides = [Parameter("model", value="quick"), Parameter("device", value="cpu")]
    server = Faulty(
        factory=server_double.make,
        context=context,
        namespace="guarded",
        parameter_overrides=overrides,
    )
    node = Node("client", context=context, namespace="guarded")
    executors = MultiThreadedExecutor(4, context=context), SingleThreadedExecutor(context=context)
    executors[0].add_node(server)
    executors[1].add_node(node)
    threads = [threading.Thread(target=spin, args=(each,), daemon=True) for each in executors]
    for thread in threads:
        thread.start()
    server.start()
    made = Pair(server, node)
    assert until(lambda: made.synthesize().success)
    yield made
    server.failing.clear()
    server.close()
    for executor, thread in zip(executors, threads):
        executor.shutdown()
        thread.join(10)
    server.destroy_node()
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def failing(pair: Pair) -> Iterator[set[str]]:
    """Return the names of what fails; afterwards everything works again."""
    yield pair.server.failing
    pair.server.failing.clear()
    assert pair.synthesize().success


REFUSED = ("synthesize_grasps", "set_gripper", "reload_grippers", "detect_bin")


def kinds() -> dict[str, Any]:
    from megrasp_msgs.srv import DetectBin, ReloadGrippers, SetGripper

    return {
        "synthesize_grasps": SynthesizeGrasps,
        "set_gripper": SetGripper,
        "reload_grippers": ReloadGrippers,
        "detect_bin": DetectBin,
    }


@pytest.mark.parametrize("name", REFUSED)
def test_a_fault_in_a_service_is_error_302(pair: Pair, failing: set[str], name: str) -> None:
    failing.add(name)
    answer = pair.call(kinds()[name], name)
    assert (answer.success, answer.error_code) == (False, ErrorCode.INTERNAL)
    assert FAULT in answer.error_msg


def test_faults_in_services_without_a_code_are_answered(pair: Pair, failing: set[str]) -> None:
    failing.add("list_grippers")
    assert pair.call(ListGrippers, "list_grippers") == ListGrippers.Response()
    failing.add("grasp_server/list_parameters")
    name = "grasp_server/list_parameters"
    assert pair.call(ListParameters, name) == ListParameters.Response()


def test_faults_in_setting_parameters_are_refusals(pair: Pair, failing: set[str]) -> None:
    failing |= {"grasp_server/set_parameters", "grasp_server/set_parameters_atomically"}
    both = [Parameter("drawn", value=50).to_parameter_msg()] * 2
    many = pair.call(
        SetParameters, "grasp_server/set_parameters", SetParameters.Request(parameters=both)
    )
    assert [each.successful for each in many.results] == [False, False]
    assert FAULT in many.results[0].reason
    one = pair.call(
        SetParametersAtomically,
        "grasp_server/set_parameters_atomically",
        SetParametersAtomically.Request(parameters=both),
    )
    assert not one.result.successful and FAULT in one.result.reason


def test_faults_in_subscriptions_and_timers_end_nothing(pair: Pair, failing: set[str]) -> None:
    names = {"subscription of tool_id", "subscription of points", "timer _each_second"}
    failing |= names
    tool = pair.node.create_publisher(String, "tool_id", LATCHED)
    from sensor_msgs.msg import PointCloud2

    points = pair.node.create_publisher(PointCloud2, "points", SENSOR)
    values = [Parameter("points_subscription", value="continuous").to_parameter_msg()]
    request = SetParameters.Request(parameters=values)
    assert pair.call(SetParameters, "grasp_server/set_parameters", request).results[0].successful
    cloud = cloud_message(
        table_points(100), frame="world", stamp=pair.node.get_clock().now().to_msg()
    )

    def all_failed() -> bool:
        tool.publish(String(data="robotiq_2f85"))
        points.publish(cloud)
        return names <= set(pair.server.failed)

    assert until(all_failed)
    for publisher in (tool, points):
        in_executor(pair.node, lambda p=publisher: pair.node.destroy_publisher(p))


def test_a_fault_in_a_goal_is_its_result(
    pair: Pair, failing: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = ActionClient(pair.node, GenerateGrasps, "generate_grasps")
    assert client.wait_for_server(60.0)
    with monkeypatch.context() as patch:

        def submit(*arguments: Any, **options: Any) -> None:
            raise RuntimeError(FAULT)

        patch.setattr(pair.server._requests, "_submit", submit)
        handle = result(
            in_executor(pair.node, lambda: client.send_goal_async(GenerateGrasps.Goal()))
        )
        answer = result(in_executor(pair.node, handle.get_result_async))
    assert answer.status == 6  # GoalStatus.STATUS_ABORTED
    assert answer.result.error_code == ErrorCode.INTERNAL
    assert FAULT in answer.result.error_msg
    in_executor(pair.node, client.destroy)


def test_a_fault_in_cancelling_leaves_the_goal_alone(pair: Pair) -> None:
    told: list[str] = []

    class Log:
        def error(self, text: str) -> None:
            told.append(text)

        def debug(self, text: str) -> None:
            pass

    log: Any = Log()
    context = rclpy.Context()
    guarded = Guard(log, context).plain("cancelling", lambda handle: 1 / 0, "refused")
    # Before its start and after its end ROS fails in whatever is asked of it.
    assert guarded(None) == "refused" and not told
    rclpy.init(context=context)
    assert guarded(None) == guarded(None) == "refused"
    # Logged once, with the traceback.
    assert len(told) == 1 and "ZeroDivisionError" in told[0] and "Traceback" in told[0]
    context.shutdown()


def test_a_fault_in_a_transition_is_a_failure(
    pair: Pair, failing: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(settings: Any) -> None:
        raise RuntimeError(FAULT)

    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState

    def change(number: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=number))
        return pair.call(ChangeState, "grasp_server/change_state", request).success

    def state() -> int:
        return pair.call(GetState, "grasp_server/get_state").current_state.id

    with monkeypatch.context() as patch:
        patch.setattr(pair.server._frames, "listen", fail)
        assert change(Transition.TRANSITION_DEACTIVATE)
        assert not change(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_ACTIVE


def test_two_servers_share_a_process(pair: Pair) -> None:
    """Name, namespace and context are arguments."""
    values = {"model": "quick", "device": "cpu", "gripper": "robotiq_3f"}
    other = GraspServer(
        "second",
        factory=server_double.make,
        context=pair.node.context,
        namespace="elsewhere",
        parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
    )
    assert other.get_fully_qualified_name() == "/elsewhere/second"
    executor = pair.server.executor
    assert executor is not None
    executor.add_node(other)
    other.start()
    cloud = stamped_cloud(pair.node, table_points())
    request = SynthesizeGrasps.Request(num_grasps=1, cloud=cloud)

    def gripper() -> str:
        name = "/elsewhere/synthesize_grasps"
        return pair.call(SynthesizeGrasps, name, request).grasps.gripper

    assert until(lambda: gripper() == "robotiq_3f")
    assert pair.synthesize().grasps.gripper == "robotiq_2f85"
    other.close()
    executor.remove_node(other)


def test_every_callback_is_among_those_above(pair: Pair) -> None:
    """What is added to the node has to be added here."""
    covered = {
        "synthesize_grasps", "set_gripper", "reload_grippers", "list_grippers", "detect_bin",
        "subscription of tool_id", "subscription of points", "timer _each_second",
        "timer _autostart",
    }  # fmt: skip
    of_rclpy = {"/parameter_events", "/clock"}
    own = {
        name
        for name in pair.server.callbacks
        if not name.startswith("grasp_server/") and not any(each in name for each in of_rclpy)
    }
    assert own == covered
    guarded = [service.callback for service in pair.server.services]
    assert len(guarded) >= 15
    assert all(hasattr(callback, "megrasp_guarded") for callback in guarded)


def test_the_source_of_this_node_makes_no_unguarded_callback() -> None:
    """Nothing is made by hand beside the guarded methods."""
    folder = Path(__file__).parents[2] / "megrasp_ros" / "megrasp_ros"
    for file in folder.rglob("*.py"):
        text = file.read_text()
        for word in ("rclpy.service.Service(", "Subscription(", "Timer("):
            made = [line for line in text.splitlines() if word in line and "import" not in line]
            assert not [line for line in made if "threading" not in line], file

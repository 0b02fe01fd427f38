"""Changes of the tool through a running server: a changer that lies, drops the tool or is slow,
goals that preempt meanwhile, the tool changed in mid-job.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from cell_processes import in_executor, result, until
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import ErrorCode, GraspArray
from megrasp_msgs.srv import ChangeTool, ListGrippers, SetGripper
from rclpy.callback_groups import ReentrantCallbackGroup
from server_client import Client, Latest, cloud_of, still_serves
from std_msgs.msg import String

from megrasp_ros.qos import LATCHED

Answer = Callable[[ChangeTool.Request, ChangeTool.Response], ChangeTool.Response]


class Changer:
    """A tool changer that answers as it is told to, when `go` is set."""

    def __init__(self, client: Client) -> None:
        self.asked, self.go = threading.Event(), threading.Event()
        self.go.set()
        self.answer: dict[str, Any] = {}
        self.service = client.node.create_service(
            ChangeTool, "changer", self.change, callback_group=ReentrantCallbackGroup()
        )

    async def change(self, request: Any, response: Any) -> Any:
        self.asked.set()
        from megrasp_ros.waiting import wake_when

        def when(call: Callable[[], None]) -> None:
            threading.Thread(target=lambda: (self.go.wait(), call()), daemon=True).start()

        await wake_when(when, self.node)
        given = {"success": True, "message": "", "mounted": request.gripper_name, **self.answer}
        for name, value in given.items():
            setattr(response, name, value)
        return response

    node: Any = None


@pytest.fixture
def changer(server: Client) -> Iterator[Changer]:
    made = Changer(server)
    made.node = server.node
    assert not server.parameters(tool_changer="changer")
    yield made
    made.go.set()
    made.answer = {}
    assert until(lambda: server.set_gripper("robotiq_2f85").success)
    assert not server.parameters(tool_changer="")
    in_executor(server.node, lambda: server.node.destroy_service(made.service))
    # A report of no tool, and a set_gripper by hand: nobody reports a tool any more.
    publisher = server.node.create_publisher(String, "tool_id", LATCHED)
    publisher.publish(String(data=""))
    assert until(lambda: code(server) == ErrorCode.TOOL_MISMATCH)
    in_executor(server.node, lambda: server.node.destroy_publisher(publisher))
    assert server.set_gripper("robotiq_2f85").success


def code(server: Client, **fields: Any) -> int:
    return server.synthesize(num_grasps=2, cloud=cloud_of(server), **fields).error_code


def active(server: Client) -> str:
    return server.call(ListGrippers.Request()).active


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        ({"mounted": "schunk_wsg32"}, "'schunk_wsg32' is mounted"),
        ({"mounted": ""}, "no tool is mounted"),
        ({"success": False, "message": "slipped", "mounted": ""}, "slipped"),
    ],
)
def test_a_changer_that_did_something_else(
    server: Client, changer: Changer, answer: dict[str, Any], text: str
) -> None:
    assert server.set_gripper("robotiq_2f85").success
    assert still_serves(server)
    poses = Latest(server, PoseArray, "pregrasps")
    assert until(lambda: bool(poses.messages) and bool(poses.last.poses))
    changer.answer = answer
    refused = server.set_gripper("robotiq_3f")
    assert (refused.success, refused.error_code) == (False, ErrorCode.TOOL_CHANGE_FAILED)
    assert text in refused.error_msg
    assert active(server) == "robotiq_2f85"
    # What is on the arm is not the active gripper, and nobody may execute the old poses.
    assert code(server) == ErrorCode.TOOL_MISMATCH
    assert until(lambda: not poses.last.poses)
    assert code(server, gripper_name="robotiq_3f") == ErrorCode.NONE


def test_a_refusal_with_the_old_tool_on_changes_nothing(server: Client, changer: Changer) -> None:
    changer.answer = {"success": False, "message": "jammed", "mounted": "robotiq_2f85"}
    refused = server.set_gripper("robotiq_3f")
    assert refused.error_code == ErrorCode.TOOL_CHANGE_FAILED
    assert "jammed" in refused.error_msg
    assert still_serves(server)


def test_preempting_goals_meanwhile_are_busy_and_block_nothing(
    server: Client, changer: Changer
) -> None:
    grasps = Latest(server, GraspArray, "grasps")
    assert still_serves(server)
    changer.asked.clear()
    changer.go.clear()
    change = server.start(SetGripper.Request(gripper_name="robotiq_3f"))
    assert changer.asked.wait(60)
    goals = [
        server.outcome(server.goal(num_grasps=1, cloud=cloud_of(server), preempt=True))
        for _ in range(10)
    ]
    assert {result(goal).result.error_code for goal in goals} == {ErrorCode.BUSY}
    assert code(server) == ErrorCode.BUSY
    # Everything else answers although ten goals came and the changer has not.
    assert not server.parameters(drawn=100)
    assert active(server) == "robotiq_2f85"
    assert until(lambda: not grasps.last.grasps)
    assert not change.done()
    changer.go.set()
    assert result(change).success
    assert active(server) == "robotiq_3f"
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.grasps.gripper == "robotiq_3f"
    assert until(lambda: grasps.last.gripper == "robotiq_3f")


def test_a_tool_changed_in_mid_job_is_error_203_and_nothing_is_published(server: Client) -> None:
    assert still_serves(server)
    grasps = Latest(server, GraspArray, "grasps")
    assert not server.parameters(model="slow")
    publisher = server.node.create_publisher(String, "tool_id", LATCHED)
    heard = threading.Event()
    try:
        handle = server.goal(
            num_grasps=2,
            cloud=cloud_of(server),
            timeout=300.0,
            feedback=lambda m: m.feedback.phase == "sample" and heard.set(),
        )
        outcome = server.outcome(handle)
        assert heard.wait(60)
        publisher.publish(String(data="robotiq_3f"))
        answer = result(outcome)
        assert answer.result.error_code == ErrorCode.TOOL_MISMATCH, answer.result.error_msg
        assert until(lambda: bool(grasps.messages) and not grasps.last.grasps)
        publisher.publish(String(data="robotiq_2f85"))
        assert not server.parameters(model="quick")
        assert until(lambda: still_serves(server))
        assert until(lambda: bool(grasps.last.grasps))
    finally:
        publisher.publish(String(data=""))
        assert until(lambda: code(server) == ErrorCode.TOOL_MISMATCH)
        in_executor(server.node, lambda: server.node.destroy_publisher(publisher))
        assert not server.parameters(model="quick")
        assert server.set_gripper("robotiq_2f85").success
    assert still_serves(server)


def test_the_parameter_gripper_takes_effect_with_the_next_request(server: Client) -> None:
    assert not server.parameters(gripper="robotiq_3f")
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.grasps.gripper == "robotiq_3f"
    assert active(server) == "robotiq_3f"
    # And set_gripper is not undone by a value that was set before it.
    assert not server.parameters(gripper="robotiq_2f85")
    assert server.set_gripper("robotiq_3f").success
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.grasps.gripper == "robotiq_3f"

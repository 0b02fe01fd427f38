"""The action: feedback, cancelling, preempting; who is busy meanwhile."""

from __future__ import annotations

import threading
import time

from cell_processes import result, until
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ListGrippers, ReloadGrippers, SetGripper, SynthesizeGrasps
from server_client import (
    Client,
    cloud_of,
    seconds_since,
    still_serves,
)


def test_the_action_gives_feedback_and_the_services_result(server: Client) -> None:
    heard: list = []
    handle = server.goal(
        num_grasps=3, cloud=cloud_of(server), feedback=lambda m: heard.append(m.feedback)
    )
    answer = result(server.outcome(handle))
    assert answer.status == 4  # GoalStatus.STATUS_SUCCEEDED
    assert len(answer.result.grasps.grasps) == 3
    assert until(lambda: any(each.phase == "check" for each in heard))
    steps = [each for each in heard if each.phase == "sample"]
    assert steps
    assert all(each.total_steps == 20 for each in steps)
    assert {each.phase for each in heard} <= {"wait", "perceive", "encode", "sample", "check"}
    # What is known so far comes with the steps of the sampler, and is marked as not checked.
    (partial,) = {each.grasps.gripper for each in steps} - {""}
    assert partial == "robotiq_2f85"
    unfinished = [grasp for each in steps for grasp in each.grasps.grasps]
    assert unfinished and not any(grasp.collision_free for grasp in unfinished)


def test_cancelling_stops_within_one_step(server: Client) -> None:
    heard = threading.Event()
    assert not server.parameters(model="slow")
    handle = server.goal(
        num_grasps=3,
        cloud=cloud_of(server),
        feedback=lambda m: m.feedback.phase == "sample" and heard.set(),
    )
    finished = server.outcome(handle)
    assert heard.wait(20)
    start = time.monotonic()
    server.cancel(handle)
    answer = result(finished)
    assert seconds_since(start) < 2 * 0.25 + 1.0
    assert answer.status == 5  # GoalStatus.STATUS_CANCELED
    assert answer.result.error_code == ErrorCode.CANCELLED
    # With the poses as they were, of the gripper, not checked.
    assert answer.result.grasps.gripper == "robotiq_2f85"
    assert [grasp.collision_free for grasp in answer.result.grasps.grasps] == [False]
    assert not server.parameters(model="quick")
    assert still_serves(server)


def test_waiting_for_a_cloud_can_be_cancelled(server: Client) -> None:
    assert not server.parameters(cloud_timeout=60.0)
    try:
        handle = server.goal(num_grasps=3)
        finished = server.outcome(handle)
        time.sleep(0.2)
        start = time.monotonic()
        server.cancel(handle)
        assert result(finished).result.error_code == ErrorCode.CANCELLED
        assert seconds_since(start) < 2.0
    finally:
        assert not server.parameters(cloud_timeout=0.7)


def test_everything_else_is_busy_meanwhile_unless_it_preempts(server: Client) -> None:
    assert not server.parameters(model="slow")
    heard = threading.Event()
    first = server.goal(num_grasps=1, cloud=cloud_of(server), feedback=lambda _: heard.set())
    first_result = server.outcome(first)
    assert heard.wait(20)
    answers = [
        server.call(SynthesizeGrasps.Request(num_grasps=1, cloud=cloud_of(server))),
        server.call(SetGripper.Request(gripper_name="robotiq_3f")),
        server.call(ReloadGrippers.Request()),
        result(server.outcome(server.goal(num_grasps=1, cloud=cloud_of(server)))).result,
    ]
    assert [answer.error_code for answer in answers] == [ErrorCode.BUSY] * 4
    assert "generate_grasps" in answers[0].error_msg
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert not server.parameters(model="quick")
    preempting = server.goal(num_grasps=1, cloud=cloud_of(server), preempt=True)
    second = result(server.outcome(preempting))
    assert second.result.success, second.result.error_msg
    assert result(first_result).result.error_code == ErrorCode.CANCELLED
    assert still_serves(server)


def test_a_request_ends_at_its_timeout(server: Client) -> None:
    assert not server.parameters(model="slow")
    start = time.monotonic()
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server), timeout=0.6)
    assert answer.error_code == ErrorCode.TIMEOUT, answer.error_msg
    assert seconds_since(start) < 3.0
    assert not server.parameters(model="quick")
    assert still_serves(server)

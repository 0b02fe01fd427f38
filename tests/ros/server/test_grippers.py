"""Setting, listing, reloading grippers; the tool on the arm."""

from __future__ import annotations

import pytest
from cell_processes import in_executor, until
from megrasp_msgs.msg import ErrorCode, GraspArray
from megrasp_msgs.srv import ListGrippers, ReloadGrippers
from server_client import (
    GRIPPERS,
    LATCHED_TOPICS,
    Client,
    Latest,
    cloud_of,
    still_serves,
)
from std_msgs.msg import String

from megrasp_core.grippers import load_gripper
from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.qos import LATCHED


def test_a_new_gripper_clears_the_poses_before_the_answer(server: Client) -> None:
    topics = {name: Latest(server, kind, name) for name, kind in LATCHED_TOPICS.items()}
    assert still_serves(server)
    assert until(
        lambda: all(topic.messages for topic in topics.values()) and topics["grasps"].last.grasps
    )
    answer = server.set_gripper("robotiq_3f")
    assert (answer.success, answer.error_code, answer.gripper.name) == (True, 0, "robotiq_3f")
    assert set(GRIPPERS) <= set(answer.available)
    assert until(lambda: not topics["grasps"].last.grasps)
    assert not topics["pregrasps"].last.poses
    assert not topics["approach_poses"].last.poses
    assert until(lambda: topics["active_gripper"].last.name == "robotiq_3f")
    assert server.synthesize(num_grasps=1, cloud=cloud_of(server)).grasps.gripper == "robotiq_3f"


def test_a_dry_run_changes_nothing(server: Client) -> None:
    grasps = Latest(server, GraspArray, "grasps")
    assert still_serves(server)
    answer = server.set_gripper("robotiq_3f", dry_run=True)
    assert (answer.success, answer.gripper.name) == (True, "robotiq_3f")
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert until(lambda: bool(grasps.messages))
    assert grasps.last.grasps


def test_gripper_info_is_complete(server: Client) -> None:
    listed = server.call(ListGrippers.Request())
    infos = {info.name: info for info in listed.grippers}
    assert set(GRIPPERS) <= set(infos)
    gripper, info = load_gripper("robotiq_2f85"), infos["robotiq_2f85"]
    assert info.kind == "adaptive" or info.kind == "parallel"
    assert info.display_name == gripper.description.display_name
    assert info.description_hash == gripper.hash
    assert dict(zip(info.joint_names, info.open_positions)) == pytest.approx(gripper.open_joints)
    assert dict(zip(info.joint_names, info.closed_positions)) == pytest.approx(
        gripper.closed_joints
    )
    assert info.max_width == pytest.approx(gripper.description.max_width)
    assert matrix_from_pose(info.gripper_from_tcp, "tcp")[:3, 3] == pytest.approx(gripper.tcp)
    assert info.seen_in_training
    assert not infos["robotiq_3f"].seen_in_training


@pytest.mark.parametrize("name", ["hook", ""])
def test_an_unknown_gripper_is_error_200_and_the_old_one_stays(server: Client, name: str) -> None:
    answer = server.set_gripper(name)
    assert (answer.success, answer.error_code) == (False, ErrorCode.UNKNOWN_GRIPPER)
    assert set(GRIPPERS) <= set(answer.available)
    assert "robotiq_2f85" in answer.error_msg
    assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
    assert still_serves(server)


def test_an_unreadable_description_is_error_201(server: Client, tmp_path) -> None:
    folder = tmp_path / "claw"
    folder.mkdir()
    (folder / "gripper.yaml").write_text("format: 1\nname: claw\nteeth: 3\n")
    refused = server.set_gripper(str(folder))
    assert (refused.success, refused.error_code) == (False, ErrorCode.UNKNOWN_GRIPPER)
    assert not server.parameters(allow_paths=True)
    answer = server.set_gripper(str(folder))
    assert not server.parameters(allow_paths=False)
    assert (answer.success, answer.error_code) == (False, ErrorCode.BAD_DESCRIPTION)
    assert "teeth" in answer.error_msg or "display_name" in answer.error_msg
    assert not server.parameters(gripper_paths=[str(tmp_path)])
    try:
        reloaded = server.call(ReloadGrippers.Request())
        assert not reloaded.success
        assert reloaded.error_code == ErrorCode.BAD_DESCRIPTION
        assert [line.split(":")[0] for line in reloaded.failed] == ["claw"]
        assert "claw" in reloaded.available
    finally:
        assert not server.parameters(gripper_paths=[""])
    assert server.call(ReloadGrippers.Request()).success
    assert still_serves(server)


def forget_tool(server: Client) -> None:
    """Reports that no tool is known, until the server has heard it."""
    publisher = server.node.create_publisher(String, "tool_id", LATCHED)
    publisher.publish(String(data=""))
    # The report may come after the first of these changes: then no tool is on again.
    assert until(lambda: server.set_gripper("franka_hand").success and still_serves(server), 10.0)
    in_executor(server.node, lambda: server.node.destroy_publisher(publisher))


def test_another_tool_on_the_arm_is_error_203(server: Client) -> None:
    publisher = server.node.create_publisher(String, "tool_id", LATCHED)
    try:
        publisher.publish(String(data="robotiq_3f"))

        def mismatch() -> bool:
            answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
            return (
                answer.error_code == ErrorCode.TOOL_MISMATCH and "robotiq_3f" in answer.error_msg
            )

        assert until(mismatch, 10.0)
        assert server.set_gripper("robotiq_3f").success
        assert still_serves(server)
        publisher.publish(String(data="robotiq_2f85"))
        assert server.set_gripper("robotiq_2f85").success
        assert until(lambda: still_serves(server), 10.0)
    finally:
        in_executor(server.node, lambda: server.node.destroy_publisher(publisher))
        forget_tool(server)


def test_a_missing_tool_changer_is_error_202(server: Client) -> None:
    from megrasp_msgs.srv import ChangeTool

    def change(request, response):
        response.success = request.gripper_name != "robotiq_3f"
        response.message = "" if response.success else "the rack is jammed"
        response.mounted = request.gripper_name if response.success else ""
        return response

    service = server.node.create_service(ChangeTool, "changer/change_tool", change)
    try:
        assert not server.parameters(tool_changer="changer/change_tool")
        answer = server.set_gripper("robotiq_3f")
        assert answer.error_code == ErrorCode.TOOL_CHANGE_FAILED, answer.error_msg
        assert "the rack is jammed" in answer.error_msg
        assert server.call(ListGrippers.Request()).active == "robotiq_2f85"
        assert server.set_gripper("robotiq_2f85").success
    finally:
        server.parameters(tool_changer="")
        in_executor(server.node, lambda: server.node.destroy_service(service))
        forget_tool(server)

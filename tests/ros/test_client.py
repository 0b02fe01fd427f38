"""The client for Python programs, against a running server."""

from __future__ import annotations

import pytest
import rclpy
from megrasp_msgs.msg import ErrorCode
from server_client import Client, cloud_of

from megrasp_ros.client import GraspClient, GraspServerError


def test_grasps_grippers_and_errors(server: Client) -> None:
    client = GraspClient(server.node)
    assert {"robotiq_2f85", "franka_hand"} <= set(client.grippers())
    assert client.set_gripper("franka_hand").name == "franka_hand"
    answer = client.synthesize(num_grasps=3, cloud=cloud_of(server), seed=4)
    assert len(answer.grasps.grasps) == 3
    assert (answer.grasps.gripper, answer.grasps.seed) == ("franka_hand", 4)
    with pytest.raises(GraspServerError, match="unknown gripper 'vacuum'") as error:
        client.set_gripper("vacuum")
    assert error.value.code == ErrorCode.UNKNOWN_GRIPPER
    with pytest.raises(GraspServerError) as error:
        client.synthesize(num_grasps=0)
    assert error.value.code == ErrorCode.INVALID_REQUEST
    assert error.value.answer.error_code == ErrorCode.INVALID_REQUEST


def test_a_server_that_is_not_there_is_told(server: Client) -> None:
    node = rclpy.create_node("elsewhere", namespace="elsewhere", context=server.node.context)
    try:
        with pytest.raises(GraspServerError, match=r"no service .*list_grippers.*0\.3 s") as error:
            GraspClient(node, timeout=0.3).grippers()
    finally:
        node.destroy_node()
    assert error.value.code == 0 and error.value.answer is None

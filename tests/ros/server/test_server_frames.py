"""Clouds in other frames: gravity, extrinsics, transforms, through grasp_server."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cell_processes import until
from geometry_msgs.msg import PoseArray
from megrasp_msgs.msg import ErrorCode
from server_client import (
    MOUNTING,
    POINTS,
    Client,
    Latest,
    cloud_of,
    still_serves,
)

from megrasp_ros.conversions import matrix_from_numbers, matrix_from_pose

DOWN_CAMERA = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]  # 1 m up, half a turn about x: looks down


def optical_points() -> np.ndarray:
    """Return the table as the camera of DOWN_CAMERA sees it."""
    return (POINTS - [0, 0, 1]) * [1, -1, -1]


def test_an_optical_frame_needs_gravity(server: Client) -> None:
    cloud = cloud_of(server, optical_points(), "camera_optical_frame")
    refused = server.synthesize(num_grasps=1, cloud=cloud)
    assert refused.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "gravity: [0.0, 0.0, 1.0]" in refused.error_msg
    assert not server.parameters(gravity=[0.0, 0.0, 2.0])
    answer = server.synthesize(num_grasps=1, cloud=cloud)
    assert answer.success, answer.error_msg
    tcp = matrix_from_pose(answer.grasps.grasps[0].tcp, "tcp")
    np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.94], atol=0.005)


def test_extrinsics_lead_into_the_planning_frame(server: Client) -> None:
    assert not server.parameters(extrinsics=DOWN_CAMERA)
    cloud = cloud_of(server, optical_points(), "camera_optical_frame")
    unnamed = server.synthesize(num_grasps=1, cloud=cloud)
    assert unnamed.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "planning_frame" in unnamed.error_msg
    assert not server.parameters(planning_frame="base_link")
    answer = server.synthesize(num_grasps=1, cloud=cloud)
    assert answer.grasps.header.frame_id == "base_link"
    tcp = matrix_from_pose(answer.grasps.grasps[0].tcp, "tcp")
    np.testing.assert_allclose(tcp[:3, 3], [0.05, 0.0, 0.06], atol=0.005)


def test_a_missing_transform_is_error_103(server: Client) -> None:
    assert not server.parameters(planning_frame="base_link")
    answer = server.synthesize(num_grasps=1, cloud=cloud_of(server))
    assert answer.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert "extrinsics" in answer.error_msg
    assert not server.parameters(planning_frame="")
    assert still_serves(server)


def test_flange_poses_carry_the_gripper_to_the_grasp(server: Client) -> None:
    """Published with `pose_reference: flange`, and the same from the page's code."""
    assert not server.parameters(pose_reference="flange")
    answer = server.synthesize(num_grasps=2, cloud=cloud_of(server))
    flange_from_gripper = matrix_from_numbers(MOUNTING, "mounting")
    for name, which in (("pregrasps", "pregrasp"), ("approach_poses", "approach")):
        topic = Latest(server, PoseArray, name)
        assert until(lambda topic=topic: bool(topic.messages))
        for pose, grasp in zip(topic.last.poses, answer.grasps.grasps, strict=True):
            world_from_gripper = matrix_from_pose(getattr(grasp, which), which)
            world_from_flange = matrix_from_pose(pose, "flange")
            assert np.linalg.norm(world_from_flange[:3, 3] - world_from_gripper[:3, 3]) > 0.011
            np.testing.assert_allclose(
                world_from_flange @ flange_from_gripper, world_from_gripper, atol=1e-7
            )
    page = (Path(__file__).parents[3] / "docs" / "frames.md").read_text()
    blocks = [part.partition("```")[0] for part in page.split("```python\n")[1:]]
    names = {"answer": answer}
    exec(next(block for block in blocks if "megrasp_ros" in block), names)
    goal = names["goal"]
    assert names["mounting"] == MOUNTING and goal.header == answer.grasps.header
    np.testing.assert_allclose(
        matrix_from_pose(goal.pose, "goal") @ flange_from_gripper,
        matrix_from_pose(answer.grasps.grasps[0].pregrasp, "pregrasp"),
        atol=1e-7,
    )

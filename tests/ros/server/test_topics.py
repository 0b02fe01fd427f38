"""Large clouds, diagnostics, pictures."""

from __future__ import annotations

import numpy as np
import pytest
from cell_processes import until
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import PointCloud2
from server_client import (
    MOUNTED,
    MOUNTING,
    Client,
    Latest,
    camera,
    cloud_of,
    table_points,
)
from visualization_msgs.msg import Marker, MarkerArray

from megrasp_core.grippers import load_gripper
from megrasp_ros.conversions import matrix_from_pose, points_from_cloud


def values_of(message: DiagnosticArray) -> dict[str, str]:
    return {pair.key: pair.value for pair in message.status[0].values}


def test_large_clouds_arrive_and_diagnostics_tell(server: Client) -> None:
    heard: list[DiagnosticArray] = []
    server.node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    assert not server.parameters(points_subscription="continuous")
    assert until(lambda: bool(heard))
    before = int(values_of(heard[-1])["clouds received"])
    # 3.7 MB each: with the default settings of Fast DDS nine out of ten such clouds are lost.
    with camera(server, table_points(280_000), rate=5.0):
        assert until(lambda: int(values_of(heard[-1])["clouds received"]) >= before + 10)
        answer = server.synthesize(num_grasps=2)
        assert answer.success, answer.error_msg
        assert until(lambda: "2 grasps" in values_of(heard[-1])["last request"])
    values = values_of(heard[-1])
    assert heard[-1].status[0].name == "/grasp_server"
    assert (values["active gripper"], values["model"], values["device"]) == (
        "robotiq_2f85",
        "quick",
        "cpu",
    )
    assert float(values["cloud rate (Hz)"]) > 0
    assert float(values["memory (MiB)"]) > 50
    assert values["GPU memory (MiB)"] == "none"
    assert values["transform"] == "none needed, clouds come in 'world'"


def test_pictures_are_made_for_those_who_look(server: Client) -> None:
    markers = Latest(server, MarkerArray, "grasp_markers")
    scene = Latest(server, PointCloud2, "scene_cloud")
    gripper = Latest(server, PointCloud2, "gripper_cloud")
    cloud = cloud_of(server)

    def drawn() -> bool:
        return (
            server.set_gripper("robotiq_2f85").success
            and server.synthesize(num_grasps=3, cloud=cloud).success
        )

    assert until(
        lambda: drawn() and bool(markers.messages and scene.messages and gripper.messages)
    )
    assert until(lambda: len(markers.last.markers) == 4)
    assert markers.last.markers[0].action == Marker.DELETEALL
    np.testing.assert_allclose(points_from_cloud(scene.last), points_from_cloud(cloud), atol=1e-6)
    tcp = load_gripper("robotiq_2f85").tcp
    points = points_from_cloud(gripper.last)
    assert points[:, 2].max() == pytest.approx(tcp[2], abs=0.02)


def test_pictures_are_made_for_those_who_come_late(server: Client) -> None:
    cloud = cloud_of(server)
    # Nobody looks while the grasps are made, and nothing more is asked for afterwards.
    assert server.synthesize(num_grasps=2, cloud=cloud).success
    markers = Latest(server, MarkerArray, "grasp_markers")
    scene = Latest(server, PointCloud2, "scene_cloud")
    gripper = Latest(server, PointCloud2, "gripper_cloud")
    assert until(lambda: bool(markers.messages and scene.messages and gripper.messages))
    assert until(lambda: len(markers.last.markers) == 3)
    # The scene of grasps that were looked at before may come first.
    assert until(lambda: scene.last.header.stamp == cloud.header.stamp)
    assert gripper.last.header.frame_id == "gripper"
    # Markers go with the gripper they are for.
    assert server.set_gripper("robotiq_3f").success
    assert until(lambda: len(markers.last.markers) == 1)
    assert markers.last.markers[0].action == Marker.DELETEALL


def test_pictures_of_another_gripper_never_come_late(server: Client) -> None:
    assert server.set_gripper("robotiq_2f85").success
    cloud = cloud_of(server)
    markers = Latest(server, MarkerArray, "grasp_markers")
    assert server.synthesize(num_grasps=2, cloud=cloud).success
    assert until(lambda: bool(markers.messages) and len(markers.last.markers) == 3)
    markers.close()
    # Nobody looks at the next grasps, and then their gripper goes.
    assert server.synthesize(num_grasps=2, cloud=cloud).success
    assert server.set_gripper("robotiq_3f").success
    late = Latest(server, MarkerArray, "grasp_markers")
    assert until(lambda: bool(late.messages))
    assert [len(message.markers) for message in late.messages] == [1]


def test_the_mounting_can_be_changed_at_run_time(server: Client) -> None:
    assert not server.parameters(pose_reference="flange")
    cloud = cloud_of(server)
    before = server.synthesize(num_grasps=1, cloud=cloud, seed=3).grasps.grasps[0]
    assert not server.parameters(
        flange_from_gripper__robotiq_2f85=[0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]
    )
    try:
        assert server.synthesize(num_grasps=1, cloud=cloud, seed=3).success
        poses = Latest(server, PoseArray, "pregrasps")
        assert until(lambda: bool(poses.messages))
        flange = matrix_from_pose(poses.last.poses[0], "flange")
        gripper = matrix_from_pose(before.pregrasp, "gripper")
        np.testing.assert_allclose(flange[:3, 3], gripper[:3, 3] - 0.5 * gripper[:3, 2], atol=1e-9)
    finally:
        assert not server.parameters(**{MOUNTED: MOUNTING})

"""realsense.launch.py with a publisher in place of the camera's driver."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from cell_processes import WAIT, default_signals, own_domain, processes, spinning_node, until
from megrasp_msgs.msg import GraspArray
from sensor_msgs.msg import PointCloud2
from server_client import stamped_cloud, table_points

from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.qos import LATCHED, SENSOR

pytest.importorskip("launch_ros", reason="ROS 2's launch is not installed")

FILE = Path(__file__).parents[3] / "launch_scripts" / "launch" / "realsense.launch.py"
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
given = dict(argument.split(":=", 1) for argument in sys.argv[2:])
service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]), launch_arguments=given.items())]))
sys.exit(service.run())
"""


def test_every_argument_says_what_it_does() -> None:
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    description = get_launch_description_from_python_launch_file(str(FILE))
    found = {each.name: each.description for each in description.get_launch_arguments()}
    assert {"driver", "gripper", "gravity", "region.pose", "region.size", "params"} <= set(found)
    assert all(len(text) > 5 for text in found.values())


def seen_from_above(height: float) -> np.ndarray:
    """The table with its block, in the axes of a camera that looks down from this height (m)."""
    return table_points(20000) * [1, -1, -1] + [0, 0, height]


@pytest.mark.slow
def test_it_ends_in_grasps(tmp_path: Path) -> None:
    """With a region, in the colour camera's optical frame, gravity along its z."""
    domain = own_domain(7)
    heard: list[GraspArray] = []
    with processes(domain, tmp_path) as running, spinning_node(domain, "fake_driver") as camera:
        camera.create_subscription(GraspArray, "grasps", heard.append, LATCHED)
        publisher = camera.create_publisher(
            PointCloud2, "/camera/camera/depth/color/points", SENSOR
        )
        stop = threading.Event()

        def publish() -> None:
            while not stop.wait(0.5):
                cloud = stamped_cloud(camera, seen_from_above(0.6), "camera_color_optical_frame")
                publisher.publish(cloud)

        thread = threading.Thread(target=publish)
        thread.start()
        log = tmp_path / "launch.log"
        with log.open("wb") as output:
            launched = subprocess.Popen(
                [sys.executable, "-c", LAUNCH, str(FILE), "driver:=false", "gripper:=franka_hand",
                 "region.pose:=[0, 0, 0.55, 0, 0, 0, 1]", "region.size:=[0.3, 0.25, 0.16]"],
                env=running.env, stdout=output, stderr=subprocess.STDOUT,
                preexec_fn=default_signals, start_new_session=True,
            )  # fmt: skip
        try:
            assert until(lambda: any(each.grasps for each in heard), 2 * WAIT), log.read_text()
        finally:
            stop.set()
            thread.join()
            launched.send_signal(signal.SIGINT)
            launched.wait(timeout=60)
    grasps = next(each for each in heard if each.grasps)
    assert grasps.header.frame_id == "camera_color_optical_frame"
    assert grasps.gripper == "franka_hand"
    for grasp in grasps.grasps:
        tcp = matrix_from_pose(grasp.tcp, "tcp")
        assert tcp[2, 2] > 0, "from above, which is along the camera's z"
        assert abs(tcp[0, 3] - 0.05) < 0.06 and abs(tcp[1, 3]) < 0.06, "at the block"
        assert 0.5 < tcp[2, 3] < 0.6, "between the table and the camera"

"""The simulated cell, the grasp server and the program that empties the bin; with RViz if asked
for: `ros2 launch megrasp_bringup demo.launch.py rviz:=true`.

The arguments of grasp_server.launch.py hold here, too.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from megrasp_ros.launching import ARGUMENTS

SHARE = get_package_share_directory("megrasp_bringup")
PARAMS = os.path.join(SHARE, "config", "demo.yaml")


def generate_launch_description() -> LaunchDescription:
    """Return the nodes; the launch ends when the bin is done."""
    arguments = [
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
        DeclareLaunchArgument("namespace", default_value="", description="of all nodes"),
        DeclareLaunchArgument("clear", default_value="true", description="start bin_clearing"),
        DeclareLaunchArgument("params", default_value=PARAMS, description="parameter file"),
        DeclareLaunchArgument(
            "objects", default_value="8", description="objects in the bin at the start"
        ),
        DeclareLaunchArgument("seed", default_value="1", description="of the scene"),
        DeclareLaunchArgument("out", default_value="out/demo", description="folder of pictures"),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="debug | info | warn | error"
        ),
        DeclareLaunchArgument(
            "respawn", default_value="false", description="start a server that has died again"
        ),
        *(
            DeclareLaunchArgument(
                name, default_value="", description=f"{text}; empty: as in params"
            )
            for name, (_, text) in ARGUMENTS.items()
        ),
    ]
    names = ["params", "namespace", "log_level", "respawn", "rviz", *ARGUMENTS]
    server = IncludeLaunchDescription(
        os.path.join(SHARE, "launch", "grasp_server.launch.py"),
        launch_arguments=[
            *((name, LaunchConfiguration(name)) for name in names),
            ("fixed_frame", "cell"),
        ],
    )
    return LaunchDescription([*arguments, server, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the cell and, if asked for, the program that empties its bin."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def node(executable: str, values: dict[str, object]) -> Node:
        return Node(
            package="megrasp_ros",
            executable=executable,
            name=executable,
            namespace=given("namespace"),
            output="screen",
            parameters=[given("params"), values],
            arguments=["--ros-args", "--log-level", given("log_level")],
        )

    # Told by the cell, so that the others may follow it.
    simulated = given("use_sim_time").lower() == "true"
    scene: dict[str, object] = {
        "num_objects": int(given("objects")),
        "seed": int(given("seed")),
    }
    cell = node("sim_cell", {**scene, "publish_clock": simulated})
    if given("clear").lower() != "true":
        return [cell]
    clearing = node("bin_clearing", {**scene, "out": given("out"), "use_sim_time": simulated})
    ended = RegisterEventHandler(
        OnProcessExit(target_action=clearing, on_exit=[EmitEvent(event=Shutdown())])
    )
    return [cell, clearing, ended]

"""The grasp server for a real camera:
`ros2 launch megrasp_bringup grasp_server.launch.py points:=/camera/camera/depth/color/points`.

An argument that is not given leaves the parameter as the file `params` has it; one that replaces
what is there is told.
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from megrasp_ros.fast_dds import profile
from megrasp_ros.launching import ARGUMENTS, parameters_given, replaced

SHARE = get_package_share_directory("megrasp_bringup")


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    arguments = [
        DeclareLaunchArgument(
            "points", default_value="points", description="topic of the camera's PointCloud2"
        ),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
        DeclareLaunchArgument(
            "params",
            default_value=os.path.join(SHARE, "config", "grasp_server.yaml"),
            description="parameter file",
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="debug | info | warn | error"
        ),
        DeclareLaunchArgument(
            "respawn", default_value="true", description="start the node again when it has died"
        ),
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
        DeclareLaunchArgument(
            "fixed_frame", default_value="", description="of RViz; empty: planning_frame"
        ),
        *(
            DeclareLaunchArgument(
                name, default_value="", description=f"{text}; empty: as in params"
            )
            for name, (_, text) in ARGUMENTS.items()
        ),
    ]
    fast_dds = SetEnvironmentVariable(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        EnvironmentVariable(
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            default_value=os.path.join(SHARE, "config", profile()),
        ),
    )
    return LaunchDescription([*arguments, fast_dds, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the node and RViz; only what was given goes over the file."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    values = parameters_given({name: given(name) for name in ARGUMENTS})
    told = [LogInfo(msg=line) for line in replaced(values, given("params"))]
    server = Node(
        package="megrasp_ros",
        executable="grasp_server",
        name="grasp_server",
        namespace=given("namespace"),
        output="screen",
        parameters=[given("params"), *([values] if values else [])],
        remappings=[("points", given("points"))],
        respawn=given("respawn").lower() == "true",
        respawn_delay=2.0,
        arguments=["--ros-args", "--log-level", given("log_level")],
    )
    frame = given("fixed_frame") or given("planning_frame")
    view = Node(
        package="rviz2",
        executable="rviz2",
        namespace=given("namespace"),
        arguments=[
            "-d",
            os.path.join(SHARE, "rviz", "megrasp.rviz"),
            *(["-f", frame] if frame else []),
        ],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return [*told, server, view]

"""The simulated cell, the grasp server and the program that empties the bin; with RViz if asked
for: `ros2 launch megrasp_bringup demo.launch.py rviz:=true`.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    RegisterEventHandler,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare("megrasp_bringup")


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes; the launch ends when the bin is done."""
    arguments = [
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz"),
        DeclareLaunchArgument("namespace", default_value="", description="of all nodes"),
        DeclareLaunchArgument("clear", default_value="true", description="start bin_clearing"),
    ]
    params = PathJoinSubstitution([SHARE, "config", "demo.yaml"])
    cell = Node(
        package="megrasp_ros",
        executable="sim_cell",
        name="sim_cell",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[params],
    )
    server = IncludeLaunchDescription(
        PathJoinSubstitution([SHARE, "launch", "grasp_server.launch.py"]),
        launch_arguments={
            "params": params,
            "namespace": LaunchConfiguration("namespace"),
            "respawn": "false",
        }.items(),
    )
    clearing = Node(
        package="megrasp_ros",
        executable="bin_clearing",
        name="bin_clearing",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[params],
        condition=IfCondition(LaunchConfiguration("clear")),
    )
    view = Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", PathJoinSubstitution([SHARE, "rviz", "megrasp.rviz"])],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    ended = RegisterEventHandler(
        OnProcessExit(target_action=clearing, on_exit=[EmitEvent(event=Shutdown())])
    )
    return LaunchDescription([*arguments, cell, server, clearing, view, ended])

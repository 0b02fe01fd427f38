"""The grasp server for a real camera:
`ros2 launch megrasp_bringup grasp_server.launch.py points:=/camera/camera/depth/color/points`.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare("megrasp_bringup")


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    arguments = [
        DeclareLaunchArgument(
            "points", default_value="points", description="topic of the camera's PointCloud2"
        ),
        DeclareLaunchArgument(
            "gripper", default_value="robotiq_2f85", description="gripper at the start"
        ),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
        DeclareLaunchArgument(
            "params",
            default_value=PathJoinSubstitution([SHARE, "config", "grasp_server.yaml"]),
            description="parameter file",
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="debug | info | warn | error"
        ),
    ]
    profile = SetEnvironmentVariable(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        EnvironmentVariable(
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            default_value=PathJoinSubstitution([SHARE, "config", "fastdds_small_buffers.xml"]),
        ),
    )
    server = Node(
        package="megrasp_ros",
        executable="grasp_server",
        name="grasp_server",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[LaunchConfiguration("params"), {"gripper": LaunchConfiguration("gripper")}],
        remappings=[("points", LaunchConfiguration("points"))],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
    )
    return LaunchDescription([*arguments, profile, server])

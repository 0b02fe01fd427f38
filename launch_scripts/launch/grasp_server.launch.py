"""The grasp server for a real camera:
`ros2 launch megrasp_bringup grasp_server.launch.py points:=/camera/camera/depth/color/points`.

An argument that is not given leaves the parameter as the file `params` has it.
"""

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare("megrasp_bringup")

OVERRIDES = {
    "gripper": "gripper at the start",
    "planning_frame": "frame of all answers",
    "gravity": "direction of gravity in the planning frame, for instance [0.0, 0.0, 1.0]",
    "extrinsics": "planning_from_cloud: [x, y, z, qx, qy, qz, qw]",
    "region.pose": "inside of the bin in the planning frame: [x, y, z, qx, qy, qz, qw]",
    "region.size": "full edges of it: [x, y, z]",
    "floor": "height of the surface the objects lie on, or [nx, ny, nz, d]",
    "use_sim_time": "true: time comes from /clock",
    "autostart": "false: a lifecycle manager configures and activates the node",
}
"""Parameters of the node that are arguments, too."""


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    arguments = [
        DeclareLaunchArgument(
            "points", default_value="points", description="topic of the camera's PointCloud2"
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
        DeclareLaunchArgument(
            "respawn", default_value="true", description="start the node again when it has died"
        ),
        *(
            DeclareLaunchArgument(
                name, default_value="", description=f"{text}; empty: as in params"
            )
            for name, text in OVERRIDES.items()
        ),
    ]
    profile = SetEnvironmentVariable(
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        EnvironmentVariable(
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            default_value=PathJoinSubstitution([SHARE, "config", "fastdds_small_buffers.xml"]),
        ),
    )
    return LaunchDescription([*arguments, profile, OpaqueFunction(function=server)])


def server(context: LaunchContext) -> list[Node]:
    """Return the node; only what was given goes over the file."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    values = {name: yaml.safe_load(given(name)) for name in OVERRIDES if given(name)}
    if isinstance(values.get("floor"), (int, float)):
        values["floor"] = [float(values["floor"])]
    for name, value in values.items():
        if isinstance(value, list):
            values[name] = [float(number) for number in value]
    return [
        Node(
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
    ]

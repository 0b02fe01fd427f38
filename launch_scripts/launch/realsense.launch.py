"""A RealSense camera that looks down, and grasps for what it sees on the topic `grasps`:
`ros2 launch megrasp_bringup realsense.launch.py gripper:=franka_hand`.

`driver:=false` leaves the camera to somebody else. `ros2 launch megrasp_bringup
realsense.launch.py --show-args` lists all arguments.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare("megrasp_bringup")

DRIVER = {
    "pointcloud.enable": "true",
    # What the colour camera does not see can be grasped all the same.
    "pointcloud.allow_no_texture_points": "true",
    # Depth in the axes of the colour camera, for masks; the cloud then comes in them, too.
    "align_depth.enable": "true",
}
"""Arguments of the driver's rs_launch.py."""

DOWN = "[0.0, 0.0, 1.0]"
"""Gravity in the optical frame of a camera that looks straight down."""

PASSED_ON = {
    "gripper": "gripper at the start; empty: as in params",
    "planning_frame": "frame of the grasps, for instance base_link; empty: the camera's optical "
    "frame (camera_color_optical_frame)",
    "extrinsics": "planning_from_cloud: [x, y, z, qx, qy, qz, qw]; empty: tf2 is asked where "
    "planning_frame is given",
    "gravity": "direction of gravity in the frame of the grasps; empty: straight away from the "
    "camera without planning_frame, else as in params",
    "region.pose": "inside of the bin in the frame of the grasps: [x, y, z, qx, qy, qz, qw]",
    "region.size": "full edges of it: [x, y, z]; empty: no region",
    "floor": "height of the surface the objects lie on, or [nx, ny, nz, d]; empty: as it is seen",
    "namespace": "of the server",
}
"""Arguments of grasp_server.launch.py."""


def generate_launch_description() -> LaunchDescription:
    """Return the camera's driver and the server."""
    arguments = [
        DeclareLaunchArgument(
            "driver", default_value="true", description="start realsense2_camera"
        ),
        DeclareLaunchArgument(
            "camera_namespace", default_value="camera", description="of the driver"
        ),
        DeclareLaunchArgument(
            "camera_name", default_value="camera", description="name of the driver's node"
        ),
        DeclareLaunchArgument(
            "serial_no", default_value="", description="which camera, as _123456; empty: any"
        ),
        DeclareLaunchArgument(
            "params",
            default_value=PathJoinSubstitution([SHARE, "config", "realsense.yaml"]),
            description="parameter file of the server",
        ),
        *(
            DeclareLaunchArgument(name, default_value="", description=text)
            for name, text in PASSED_ON.items()
        ),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=camera_and_server)])


def camera_and_server(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return what is started; arguments are known here."""

    def given(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    passed = {name: given(name) for name in PASSED_ON}
    if not passed["gravity"] and not passed["planning_frame"]:
        passed["gravity"] = DOWN
    place, name = given("camera_namespace").strip("/"), given("camera_name")
    server = IncludeLaunchDescription(
        PathJoinSubstitution([SHARE, "launch", "grasp_server.launch.py"]),
        launch_arguments={
            **passed,
            "params": given("params"),
            "points": "/".join(["", *filter(None, (place, name)), "depth/color/points"]),
        }.items(),
    )
    if given("driver").lower() != "true":
        return [server]
    driver = {**DRIVER, "camera_namespace": place, "camera_name": name}
    if given("serial_no"):
        driver["serial_no"] = given("serial_no")
    camera = IncludeLaunchDescription(
        PathJoinSubstitution([FindPackageShare("realsense2_camera"), "launch", "rs_launch.py"]),
        launch_arguments=driver.items(),
    )
    return [camera, server]

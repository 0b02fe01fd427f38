"""The names that grasp_server has, for docs/ros.md; a test holds them against the node."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Name:
    """A topic, service or action; `kind` is its type, `heard` says that the node listens."""

    kind: str
    text: str
    heard: bool = False


NAMES: dict[str, Name] = {
    "points": Name(
        "sensor_msgs/msg/PointCloud2",
        "best effort, depth 1; subscribed per request unless `points_subscription` is "
        "`continuous`",
        heard=True,
    ),
    "depth": Name(
        "sensor_msgs/msg/Image",
        "with `input: depth`, in place of `points`: 16UC1 in mm or 32FC1 in m, rectified",
        heard=True,
    ),
    "camera_info": Name("sensor_msgs/msg/CameraInfo", "of the depth image", heard=True),
    "mask": Name(
        "sensor_msgs/msg/Image",
        "which object a pixel shows, where somebody publishes it",
        heard=True,
    ),
    "tool_id": Name(
        "std_msgs/msg/String",
        "latched; what the tool changer holds; a mismatch is error 203",
        heard=True,
    ),
    "pregrasps": Name(
        "geometry_msgs/msg/PoseArray",
        "latched, best first, in the planning frame with the stamp of the cloud",
    ),
    "approach_poses": Name("geometry_msgs/msg/PoseArray", "same order, at the stand-off"),
    "grasps": Name("megrasp_msgs/msg/GraspArray", "latched; poses, postures, width, score"),
    "active_gripper": Name("megrasp_msgs/msg/GripperInfo", "latched; the gripper that is on"),
    "scene_cloud": Name("sensor_msgs/msg/PointCloud2", "made only with subscribers"),
    "gripper_cloud": Name(
        "sensor_msgs/msg/PointCloud2", "the open gripper, frame `gripper`; likewise"
    ),
    "grasp_markers": Name("visualization_msgs/msg/MarkerArray", "likewise, for RViz"),
    "/diagnostics": Name(
        "diagnostic_msgs/msg/DiagnosticArray",
        "each second: cloud age and rate, transform, model, latency, memory, gripper",
    ),
    "/tf_static": Name(
        "tf2_msgs/msg/TFMessage",
        "`flange_frame` to `gripper` to `gripper_tcp` of the active gripper",
    ),
    "synthesize_grasps": Name("megrasp_msgs/srv/SynthesizeGrasps", "service"),
    "set_gripper": Name("megrasp_msgs/srv/SetGripper", "service"),
    "list_grippers": Name("megrasp_msgs/srv/ListGrippers", "service"),
    "reload_grippers": Name("megrasp_msgs/srv/ReloadGrippers", "service"),
    "detect_bin": Name("megrasp_msgs/srv/DetectBin", "service; pose, size and fill of the bin"),
    "generate_grasps": Name(
        "megrasp_msgs/action/GenerateGrasps",
        "action; feedback per phase and step, cancel stops within one step",
    ),
}

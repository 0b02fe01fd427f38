"""The parameters of grasp_server: defaults, descriptions, ranges and checks in one table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
)
from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name

from megrasp_core.errors import InvalidRequestError
from megrasp_core.limits import MAX_DRAWN, MAX_EDGE, MAX_GRASPS
from megrasp_ros.conversions import FARTHEST, checked_pose
from megrasp_ros.errors import shortened

from .stamps import LONGEST_NAME

FLANGE_PREFIX = "flange_from_gripper."
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
SHORTEST = 1e-6
"""Of a vector that is to give a direction."""

UNSET = [0.0] * 7
"""A pose that was not given."""

Check = Callable[[Any], str]


@dataclass(frozen=True)
class Spec:
    """A parameter: its default gives its type; `check` returns what is wrong with a value, "" when
    nothing is.
    """

    default: Any
    description: str
    low: float | None = None
    high: float | None = None
    check: Check | None = None
    read_only: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(description=self.description, read_only=self.read_only)
        if self.low is not None and self.high is not None:
            if isinstance(self.default, float):
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=self.low, to_value=self.high)
                ]
            else:
                descriptor.integer_range = [
                    IntegerRange(from_value=int(self.low), to_value=int(self.high))
                ]
        return descriptor


def _one_of(*choices: str) -> Check:
    return lambda value: (
        "" if value in choices else f"{value!r} was given; expected one of {', '.join(choices)}"
    )


def _numbers(count: int, meaning: str) -> Check:
    def check(value: Sequence[float]) -> str:
        if len(value) == count and all(abs(v) <= FARTHEST for v in value):
            return ""
        return f"{_shown(value)} was given; expected {count} finite numbers: {meaning}"

    return check


def _shown(value: Sequence[float]) -> str:
    return shortened(str(list(value)), 200)


def _direction(vector: Sequence[float]) -> bool:
    """Whether it is 0 0 0, which stands for unset, or long enough to point somewhere."""
    return not any(vector) or math.hypot(*vector) >= SHORTEST


def _gravity(value: Sequence[float]) -> str:
    wrong = _numbers(3, "the direction that things fall, in the planning frame")(value)
    if wrong or _direction(value):
        return wrong
    return f"{_shown(value)} was given; expected a vector that points somewhere, such as 0 0 -1"


def _frame(value: str) -> str:
    if len(value) <= LONGEST_NAME:
        return ""
    return f"{value[:40]!r} and more was given; expected the name of a frame"


def pose_check(unset_allowed: bool) -> Check:
    """Return a check for 7 numbers of a pose; with `unset_allowed` all 0 is fine."""

    def check(value: Sequence[float]) -> str:
        if unset_allowed and len(value) == 7 and not any(value):
            return ""
        try:
            checked_pose(list(value), "the value")
        except InvalidRequestError as error:
            return str(error)
        return ""

    return check


def _size(value: Sequence[float]) -> str:
    wrong = _numbers(3, "full edges in metres, all 0: no region")(value)
    if wrong or not any(value):
        return wrong
    if not all(v > 0 for v in value):
        return f"{list(value)} was given; expected three edges over 0 (m), or all 0 for no region"
    if max(value) > MAX_EDGE:
        return (
            f"{list(value)} was given; expected metres, up to {MAX_EDGE:g}. It looks like "
            "millimetres: divide region.size and the place of region.pose by 1000"
        )
    return ""


def _device(value: str) -> str:
    if re.fullmatch(r"auto|cpu|cuda(:\d{1,3})?", value):
        return ""
    return f"{value[:40]!r} was given; expected auto, cpu, cuda or cuda:N"


def _service(value: str) -> str:
    if not value:
        return ""
    try:
        full = expand_topic_name(value, "node", "/")
        validate_full_topic_name(full, is_service=True)
    except (ValueError, InvalidTopicNameException, InvalidServiceNameException):
        return f"{value[:80]!r} was given; expected the name of a service, such as change_tool"
    return ""


def _floor(value: Sequence[float]) -> str:
    if len(value) == 1 and abs(value[0]) <= FARTHEST:
        return ""
    wrong = _numbers(4, "nx, ny, nz, d of a plane; or one number, its height")(value)
    if wrong or not any(value) or (any(value[:3]) and _direction(value[:3])):
        return wrong
    return f"{list(value)} was given; expected a normal that is not 0 0 0"


TABLE: dict[str, Spec] = {
    "autostart": Spec(
        True,
        "configure and activate by itself at the start; false: a lifecycle manager does it",
        read_only=True,
    ),
    "gripper": Spec(
        "robotiq_2f85",
        "gripper that is active after configuring: a registered name or the folder of a "
        "gripper.yaml",
    ),
    "gripper_paths": Spec([""], "folders with further grippers, searched before the shipped ones"),
    "allow_paths": Spec(
        False,
        "gripper_name in a request may be the folder of a gripper.yaml; false: a registered name",
    ),
    "rack": Spec([""], 'grippers that a request for "auto" chooses from; empty: the active one'),
    "swap_cost": Spec(
        0.0,
        "score that another gripper than the mounted one must gain to be chosen by a request for "
        '"auto": what changing the tool is worth as probability of success',
        0.0,
        1.0,
    ),
    "model": Spec("", "model id or folder; empty: the default for the kind of the gripper"),
    "device": Spec(
        "auto", "auto | cpu | cuda | cuda:N; auto takes a GPU if there is one", check=_device
    ),
    "threads": Spec(0, "CPU threads of the decoder; 0: torch's choice", 0, 256),
    "input": Spec(
        "points",
        "where clouds come from: points, the topic of that name; depth: the topics depth (16UC1 "
        "in mm or 32FC1 in m, rectified), camera_info, and mask (numbers of objects) if somebody "
        "publishes it",
        check=_one_of("points", "depth"),
    ),
    "sync_tolerance": Spec(
        0.0,
        "with input depth: most difference of the stamps of depth, camera_info and mask (s)",
        0.0,
        1.0,
    ),
    "planning_frame": Spec(
        "", "frame of all answers; empty: the frame of the cloud", check=_frame
    ),
    "extrinsics": Spec(
        UNSET,
        "planning_from_cloud as x, y, z, qx, qy, qz, qw; all 0: unset, tf2 is asked when "
        "planning_frame differs",
        check=pose_check(unset_allowed=True),
    ),
    "tf_timeout": Spec(0.2, "longest wait for a transform from tf2 (s)", 0.0, 60.0),
    "gravity": Spec(
        [0.0] * 3,
        "direction of gravity in the planning frame; all 0: unset, then -z, but an error in an "
        "optical frame",
        check=_gravity,
    ),
    "sensor_origin": Spec(
        [0.0] * 3,
        "place of the sensor in the frame of the cloud (m); the default is the origin of that "
        "frame, which is where that of a depth image always is",
        check=_numbers(3, "x, y, z in metres"),
    ),
    "pose_reference": Spec(
        "gripper",
        "which frame the poses of `pregrasps` and `approach_poses` place: gripper | tcp | flange",
        check=_one_of("gripper", "tcp", "flange"),
    ),
    "flange_frame": Spec(
        "flange",
        "frame that the active gripper hangs on in tf2: `gripper` and `gripper_tcp` are published "
        "below it on /tf_static (where tf2_msgs is installed); empty: not",
        check=_frame,
    ),
    "region.pose": Spec(
        list(IDENTITY),
        "centre and axes of the region (the inside of the bin) in the planning frame: x, y, z, "
        "qx, qy, qz, qw",
        check=pose_check(unset_allowed=False),
    ),
    "region.size": Spec(
        [0.0] * 3, "full edges of the region (m); all 0: no region, the whole cloud", check=_size
    ),
    "region.walls": Spec(
        True,
        "the sides of the region are walls and its bottom the floor: grasps may not cross them",
    ),
    "floor": Spec(
        [0.0] * 4,
        "the surface that the objects lie on, in the planning frame, for clouds that do not show "
        "it: one number, its height over the origin against gravity (m), or nx, ny, nz, d of the "
        "plane nx x + ny y + nz z = d whose normal points up; four times 0: not known",
        check=_floor,
    ),
    "assume_empty": Spec(
        False,
        "where the camera saw nothing there is floor or, in a region with walls, wall; otherwise "
        "that is said only of a floor that shows almost nowhere",
    ),
    "cloud_max_age": Spec(
        5.0,
        "oldest cloud of the topic, or depth image, that is used (s, by its stamp); 0: any. A "
        "cloud in a request may be of any age",
        0.0,
        3600.0,
    ),
    "cloud_timeout": Spec(
        5.0, "longest wait for a cloud on `points`, or all of a depth image (s)", 0.05, 600.0
    ),
    "num_grasps": Spec(20, "grasps of a synthesis by auto_synthesize", 1, MAX_GRASPS),
    "max_num_grasps": Spec(1000, "most grasps a request may ask for", 1, MAX_GRASPS),
    "drawn": Spec(100, "poses drawn per synthesis; at least num_grasps are drawn", 1, MAX_DRAWN),
    "more_rounds": Spec(
        3, "while no grasp is good, as many poses are drawn once more, at most so often", 0, 100
    ),
    "max_tilt": Spec(
        math.pi, "largest angle between the gripper's +Z and gravity (rad); pi: any", 0.01, math.pi
    ),
    "approach_distance": Spec(
        0.10, "distance of the approach pose from the pre-grasp (m)", 0.0, 1.0
    ),
    "approach_direction": Spec(
        "tool",
        "tool: back along the gripper's -Z; gravity: straight up",
        check=_one_of("tool", "gravity"),
    ),
    "min_score": Spec(0.0, "grasps with a lower score are left out; 0: none is", 0.0, 1.0),
    "prefer": Spec(
        "score",
        "what comes first: score; high: the highest against gravity; clear: the most clearance",
        check=_one_of("score", "high", "clear"),
    ),
    "request_timeout": Spec(60.0, "longest time from request to answer (s)", 0.05, 3600.0),
    "result_timeout": Spec(
        10.0,
        "how long the result of a finished goal is kept for its client (s)",
        0.0,
        3600.0,
        read_only=True,
    ),
    "auto_synthesize": Spec(
        "off",
        "off | on_cloud: publish grasps for new clouds without a call",
        check=_one_of("off", "on_cloud"),
    ),
    "auto_period": Spec(1.0, "shortest time between two automatic syntheses (s)", 0.0, 3600.0),
    "points_subscription": Spec(
        "on_demand",
        "on_demand: `points`, or `depth` and what belongs to it, is subscribed while a request "
        "waits; continuous: always (no wait, more load)",
        check=_one_of("on_demand", "continuous"),
    ),
    "tool_changer": Spec(
        "",
        "ChangeTool service that set_gripper calls before it switches; empty: the tool is changed "
        "by others",
        check=_service,
    ),
}

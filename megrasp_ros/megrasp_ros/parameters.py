"""The parameters of grasp_server: one table with descriptions, ranges and checks, and a typed
snapshot of it.

Changes are checked when they are made and take effect with the next request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.pointcloud import OrientedBox
from megrasp_core.synthesizer import MAX_DRAWN, MAX_GRASPS
from megrasp_ros.conversions import matrix_from_numbers

FLANGE_PREFIX = "flange_from_gripper."
_IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]

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
        if len(value) == count and all(math.isfinite(v) for v in value):
            return ""
        return f"{list(value)} was given; expected {count} finite numbers: {meaning}"

    return check


def _pose(unset_allowed: bool) -> Check:
    def check(value: Sequence[float]) -> str:
        if unset_allowed and len(value) == 7 and not any(value):
            return ""
        try:
            matrix_from_numbers(list(value), "the value")
        except InvalidRequestError as error:
            return str(error)
        return ""

    return check


def _size(value: Sequence[float]) -> str:
    wrong = _numbers(3, "full edges in metres, all 0: no region")(value)
    if wrong or not any(value) or all(v > 0 for v in value):
        return wrong
    return f"{list(value)} was given; expected three edges over 0 (m), or all 0 for no region"


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
    "rack": Spec([""], 'grippers that a request for "auto" chooses from; empty: the active one'),
    "model": Spec("", "model id or folder; empty: the default model"),
    "device": Spec("auto", "auto | cpu | cuda | cuda:N; auto takes a GPU if there is one"),
    "threads": Spec(0, "CPU threads of one synthesis; 0: torch's choice", 0, 256),
    "planning_frame": Spec("", "frame of all answers; empty: the frame of the cloud"),
    "extrinsics": Spec(
        [0.0] * 7,
        "planning_from_cloud as x, y, z, qx, qy, qz, qw; all 0: unset, tf2 is asked when "
        "planning_frame differs",
        check=_pose(unset_allowed=True),
    ),
    "gravity": Spec(
        [0.0] * 3,
        "direction of gravity in the planning frame; all 0: unset, then -z, but an error in an "
        "optical frame",
        check=_numbers(3, "the direction that things fall, in the planning frame"),
    ),
    "sensor_origin": Spec(
        [0.0] * 3,
        "place of the sensor in the frame of the cloud (m); the default is the origin of that "
        "frame",
        check=_numbers(3, "x, y, z in metres"),
    ),
    "pose_reference": Spec(
        "gripper",
        "which frame the poses of `pregrasps` and `approach_poses` place: gripper | tcp | flange",
        check=_one_of("gripper", "tcp", "flange"),
    ),
    "region.pose": Spec(
        list(_IDENTITY),
        "centre and axes of the region (the inside of the bin) in the planning frame: x, y, z, "
        "qx, qy, qz, qw",
        check=_pose(unset_allowed=False),
    ),
    "region.size": Spec(
        [0.0] * 3, "full edges of the region (m); all 0: no region, the whole cloud", check=_size
    ),
    "region.walls": Spec(
        True,
        "the sides of the region are walls and its bottom the floor: grasps may not cross them",
    ),
    "cloud_max_age": Spec(5.0, "oldest cloud that is used (s, by its stamp); 0: any", 0.0, 3600.0),
    "cloud_timeout": Spec(5.0, "longest wait for a cloud on `points` (s)", 0.05, 600.0),
    "num_grasps": Spec(20, "grasps of a synthesis by auto_synthesize", 1, MAX_GRASPS),
    "max_num_grasps": Spec(1000, "most grasps a request may ask for", 1, MAX_GRASPS),
    "drawn": Spec(100, "poses drawn per synthesis; at least num_grasps are drawn", 1, MAX_DRAWN),
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
    "request_timeout": Spec(60.0, "longest time from request to answer (s)", 0.05, 3600.0),
    "auto_synthesize": Spec(
        "off",
        "off | on_cloud: publish grasps for new clouds without a call",
        check=_one_of("off", "on_cloud"),
    ),
    "auto_period": Spec(1.0, "shortest time between two automatic syntheses (s)", 0.0, 3600.0),
    "points_subscription": Spec(
        "on_demand",
        "on_demand: `points` is subscribed while a request waits; continuous: always (no wait, "
        "more load)",
        check=_one_of("on_demand", "continuous"),
    ),
    "tool_changer": Spec(
        "",
        "ChangeTool service that set_gripper calls before it switches; empty: the tool is changed "
        "by others",
    ),
}


@dataclass(frozen=True)
class Settings:
    """The parameters as one request sees them. Field names are those of the table, '.' as '_'."""

    gripper: str
    gripper_paths: tuple[str, ...]
    rack: tuple[str, ...]
    model: str
    device: str
    threads: int
    planning_frame: str
    extrinsics: NDArray[np.float64] | None
    gravity: NDArray[np.float64] | None
    sensor_origin: NDArray[np.float64]
    pose_reference: str
    region: OrientedBox | None
    region_walls: bool
    cloud_max_age: float
    cloud_timeout: float
    num_grasps: int
    max_num_grasps: int
    drawn: int
    max_tilt: float
    approach_distance: float
    approach_direction: str
    request_timeout: float
    auto_synthesize: str
    auto_period: float
    points_subscription: str
    tool_changer: str


def declare(node: Node) -> None:
    """Declare the table's parameters and every `flange_from_gripper.<name>` that was given at the
    start.
    """
    for name, spec in TABLE.items():
        node.declare_parameter(name, spec.default, spec.descriptor())
    for name in sorted(getattr(node, "_parameter_overrides", {})):
        if name.startswith(FLANGE_PREFIX):
            declare_flange(node, name.removeprefix(FLANGE_PREFIX))
    node.add_on_set_parameters_callback(check_parameters)
    # The callback is not asked about the values given at the start.
    check_all(node)


def declare_flange(node: Node, gripper: str) -> None:
    """Declare `flange_from_gripper.<gripper>` unless it is there."""
    name = FLANGE_PREFIX + gripper
    if not node.has_parameter(name):
        description = f"pose of {gripper}'s gripper frame in the robot's flange frame: x, y, z, qx, qy, qz, qw"
        node.declare_parameter(name, list(_IDENTITY), ParameterDescriptor(description=description))


def flange_from_gripper(node: Node, gripper: Gripper) -> NDArray[np.float64]:
    """Return (4, 4): the parameter if it was given, else what the description says, else the
    identity.
    """
    name = FLANGE_PREFIX + gripper.name
    if node.has_parameter(name):
        return matrix_from_numbers(node.get_parameter(name).value, name)
    described = gripper.description.flange_from_gripper
    return np.eye(4) if described is None else described.matrix()


def check_all(node: Node) -> None:
    """Raise InvalidRequestError when a parameter's value is not usable."""
    names = [*TABLE, *(n for n in node._parameters if n.startswith(FLANGE_PREFIX))]
    result = check_parameters([node.get_parameter(name) for name in names])
    if not result.successful:
        raise InvalidRequestError(result.reason)


def check_parameters(parameters: list[Parameter]) -> SetParametersResult:
    """Accept or refuse new values; ranges and types have been checked by rclpy."""
    for parameter in parameters:
        spec = TABLE.get(parameter.name)
        check = spec.check if spec is not None else None
        if parameter.name.startswith(FLANGE_PREFIX):
            check = _pose(unset_allowed=False)
        wrong = check(parameter.value) if check is not None else ""
        if wrong:
            return SetParametersResult(
                successful=False, reason=f"parameter {parameter.name}: {wrong}"
            )
    return SetParametersResult(successful=True)


def read(node: Node) -> Settings:
    """Return the current values."""
    values = {name: node.get_parameter(name).value for name in TABLE}
    values.pop("autostart")
    size, pose = list(values.pop("region.size")), values.pop("region.pose")
    region = (
        OrientedBox(matrix_from_numbers(pose, "region.pose"), np.array(size))
        if any(size)
        else None
    )
    values["region_walls"] = values.pop("region.walls")
    extrinsics, gravity = (
        list(values.pop("extrinsics")),
        np.array(values.pop("gravity"), dtype=np.float64),
    )
    length = float(np.linalg.norm(gravity))
    return Settings(
        **{
            **values,
            "gripper_paths": tuple(path for path in values["gripper_paths"] if path),
            "rack": tuple(name for name in values["rack"] if name),
            "region": region,
            "extrinsics": matrix_from_numbers(extrinsics, "extrinsics")
            if any(extrinsics)
            else None,
            "gravity": gravity / length if length > 0 else None,
            "sensor_origin": np.array(values["sensor_origin"], dtype=np.float64),
        }
    )

"""The parameters of grasp_server: declared from the table, checked, and read as a typed snapshot.

Changes are checked when they are made and take effect with the next request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import (
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.pointcloud import OrientedBox, Plane
from megrasp_ros.conversions import matrix_from_numbers

from .parameter_table import FLANGE_PREFIX, IDENTITY, TABLE, pose_check


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
    floor: Plane | float | None
    assume_empty: bool
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
        description = f"gripper frame of {gripper} in the robot's flange frame: x y z qx qy qz qw"
        node.declare_parameter(name, list(IDENTITY), ParameterDescriptor(description=description))


def flange_from_gripper(node: Node, gripper: Gripper) -> NDArray[np.float64]:
    """Return (4, 4): the parameter if it was given, else what the description says, else the
    identity.
    """
    name = FLANGE_PREFIX + gripper.name
    if node.has_parameter(name):
        numbers: Any = node.get_parameter(name).value
        return matrix_from_numbers(numbers, name)
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
            check = pose_check(unset_allowed=False)
        wrong = check(parameter.value) if check is not None else ""
        if wrong:
            return SetParametersResult(
                successful=False, reason=f"parameter {parameter.name}: {wrong}"
            )
    return SetParametersResult(successful=True)


def read(node: Node) -> Settings:
    """Return the current values."""
    values: dict[str, Any] = {name: node.get_parameter(name).value for name in TABLE}
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
            "floor": _floor(values["floor"]),
            "extrinsics": matrix_from_numbers(extrinsics, "extrinsics")
            if any(extrinsics)
            else None,
            "gravity": gravity / length if length > 0 else None,
            "sensor_origin": np.array(values["sensor_origin"], dtype=np.float64),
        }
    )


def _floor(numbers: Sequence[float]) -> Plane | float | None:
    if len(numbers) == 1:
        return float(numbers[0])
    normal = np.asarray(numbers[:3], dtype=np.float64)
    length = float(np.linalg.norm(normal))
    return Plane(normal / length, float(numbers[3]) / length) if length else None

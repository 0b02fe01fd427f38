"""The parameters of grasp_server: declared from the table, checked, and read as a typed snapshot.

Changes are checked when they are made and take effect with the next request.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import (
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from megrasp_core.errors import DescriptionError, InvalidRequestError
from megrasp_ros.conversions import matrix_from_numbers
from megrasp_ros.errors import MOST_TEXT, shortened

from .live_check import LiveCheck
from .parameter_table import FLANGE_PREFIX, TABLE, UNSET, pose_check

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.pointcloud import OrientedBox, Plane


@dataclass(frozen=True)
class Settings:
    """The parameters as one request sees them. Field names are those of the table, '.' as '_'."""

    gripper: str
    gripper_paths: tuple[str, ...]
    allow_paths: bool
    rack: tuple[str, ...]
    swap_cost: float
    model: str
    device: str
    threads: int
    input: str
    sync_tolerance: float
    planning_frame: str
    extrinsics: NDArray[np.float64] | None
    tf_timeout: float
    gravity: NDArray[np.float64] | None
    sensor_origin: NDArray[np.float64]
    pose_reference: str
    flange_frame: str
    region: OrientedBox | None
    region_walls: bool
    floor: Plane | float | None
    assume_empty: bool
    cloud_max_age: float
    cloud_timeout: float
    num_grasps: int
    max_num_grasps: int
    drawn: int
    more_rounds: int
    max_tilt: float
    approach_distance: float
    approach_direction: str
    min_score: float
    prefer: str
    request_timeout: float
    result_timeout: float
    auto_synthesize: str
    auto_period: float
    points_subscription: str
    tool_changer: str


def declare(node: Node, live: LiveCheck) -> None:
    """Declare the table's parameters.

    Raises InvalidRequestError when a value given at the start is not usable. What depends on disk
    and machine (`live`) is asked for later changes only: at the start, configuring finds it out.
    """
    for name, spec in TABLE.items():
        node.declare_parameter(name, spec.default, spec.descriptor())
    given = [node.get_parameter(name) for name in TABLE]
    refused = _first_wrong(given)
    if refused:
        raise InvalidRequestError(refused)
    node.add_on_set_parameters_callback(lambda changed: _checked(node, changed, live))


def declare_flanges(node: Node, live: LiveCheck) -> None:
    """Declare `flange_from_gripper.<name>` of the registered grippers.

    Raises InvalidRequestError when a value given at the start is not usable.
    """
    try:
        names = live.shelf.names(_paths(node.get_parameter("gripper_paths").value))
    except DescriptionError:
        # Of no weight for the rest: whoever needs a gripper is told.
        return
    for name in names:
        declare_flange(node, name)


def declare_flange(node: Node, gripper: str) -> None:
    """Declare `flange_from_gripper.<gripper>` unless it is there. Raises InvalidRequestError."""
    name = FLANGE_PREFIX + gripper
    if node.has_parameter(name):
        return
    description = (
        f"gripper frame of {gripper} in the robot's flange frame: x y z qx qy qz qw; all 0: what "
        "its description says, else the identity"
    )
    given = node.declare_parameter(name, list(UNSET), ParameterDescriptor(description=description))
    wrong = pose_check(unset_allowed=True)(given.value)
    if wrong:
        raise InvalidRequestError(f"parameter {name}: {wrong}")


def flange_from_gripper(node: Node, gripper: Gripper) -> NDArray[np.float64]:
    """Return (4, 4): the parameter if it was given, else what the description says, which is the
    identity where it says nothing.
    """
    name = FLANGE_PREFIX + gripper.name
    declare_flange(node, gripper.name)
    numbers: Any = node.get_parameter(name).value
    if any(numbers):
        return matrix_from_numbers(numbers, name)
    return gripper.description.flange_from_gripper.matrix()


def _checked(node: Node, changed: list[Parameter], live: LiveCheck) -> SetParametersResult:
    """Accept or refuse new values; ranges and types have been checked by rclpy."""
    wrong = _first_wrong(changed)
    if not wrong:
        values = {name: node.get_parameter(name).value for name in TABLE}
        values |= {parameter.name: parameter.value for parameter in changed}
        wrong = live.wrong({parameter.name for parameter in changed}, values)
    return SetParametersResult(successful=not wrong, reason=shortened(wrong, MOST_TEXT))


def _first_wrong(parameters: Sequence[Parameter]) -> str:
    for parameter in parameters:
        spec = TABLE.get(parameter.name)
        check = spec.check if spec is not None else None
        if parameter.name.startswith(FLANGE_PREFIX):
            check = pose_check(unset_allowed=True)
        value: Any = parameter.value
        if isinstance(value, float) and not math.isfinite(value):
            return f"parameter {parameter.name}: {value} was given; expected a finite number"
        wrong = check(value) if check is not None else ""
        if wrong:
            return f"parameter {parameter.name}: {wrong}"
    return ""


def _paths(value: Any) -> tuple[str, ...]:
    return tuple(path for path in value if path)


def read(node: Node) -> Settings:
    """Return the current values."""
    return settings_of({name: node.get_parameter(name).value for name in TABLE})


def settings_of(parameters: Mapping[str, Any]) -> Settings:
    """Return the settings of the values of all parameters in the table, by their names."""
    values = dict(parameters)
    values.pop("autostart")
    size, pose = list(values.pop("region.size")), values.pop("region.pose")
    from megrasp_core.pointcloud import OrientedBox

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
            "gripper_paths": _paths(values["gripper_paths"]),
            "rack": _paths(values["rack"]),
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
    from megrasp_core.pointcloud import Plane

    if len(numbers) == 1:
        return float(numbers[0])
    normal = np.asarray(numbers[:3], dtype=np.float64)
    length = float(np.linalg.norm(normal))
    return Plane(normal / length, float(numbers[3]) / length) if length else None

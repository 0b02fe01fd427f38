"""Launch arguments that are parameters of grasp_server, too.

An argument that is not given leaves the parameter as the file has it; one that is goes over the
file, and what it replaces is told. Needs neither `launch` nor rclpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

SWITCH, NUMBERS, TEXT = "true or false", "numbers in brackets", "text"

ARGUMENTS: dict[str, tuple[str, str]] = {
    "gripper": (TEXT, "gripper at the start"),
    "model": (TEXT, "model id or folder"),
    "device": (TEXT, "auto | cpu | cuda | cuda:N"),
    "planning_frame": (TEXT, "frame of all answers"),
    "gravity": (NUMBERS, "direction of gravity in the planning frame, e.g. [0.0, 0.0, 1.0]"),
    "sensor_origin": (NUMBERS, "place of the sensor in the frame of the cloud: [x, y, z]"),
    "extrinsics": (NUMBERS, "planning_from_cloud: [x, y, z, qx, qy, qz, qw]"),
    "region.pose": (NUMBERS, "inside of the bin, planning frame: [x, y, z, qx, qy, qz, qw]"),
    "region.size": (NUMBERS, "full edges of it: [x, y, z]"),
    "floor": (NUMBERS, "height of the surface the objects lie on, or [nx, ny, nz, d]"),
    "use_sim_time": (SWITCH, "true: time comes from /clock"),
    "autostart": (SWITCH, "false: a lifecycle manager configures and activates the node"),
    "tool_changer": (TEXT, "ChangeTool service that set_gripper calls"),
}
"""Name -> kind and description; the names are those of the parameters."""


def parameters_given(arguments: Mapping[str, str]) -> dict[str, Any]:
    """Return the parameters for the arguments that are not empty.

    Raises ValueError for one that is not of its kind.
    """
    given = {}
    for name, text in arguments.items():
        if text == "":
            continue
        kind, description = ARGUMENTS[name]
        try:
            given[name] = _value(kind, text)
        except (ValueError, TypeError, yaml.YAMLError):
            raise ValueError(
                f"launch argument {name}:={text!r} was given; expected {kind}: {description}"
            ) from None
    return given


def _value(kind: str, text: str) -> Any:
    if kind == TEXT:
        return text
    value = yaml.safe_load(text)
    if kind == SWITCH:
        if not isinstance(value, bool):
            raise ValueError
        return value
    numbers = value if isinstance(value, list) else [value]
    if any(isinstance(number, bool) for number in numbers):
        raise ValueError
    return [float(number) for number in numbers]


def replaced(given: Mapping[str, Any], file: str, node: str = "grasp_server") -> list[str]:
    """Return a line for each parameter in a parameter file that `given` replaces."""
    path = Path(file)
    content = yaml.safe_load(path.read_text()) if path.is_file() else {}
    found: dict[str, Any] = {}
    for key, section in (content or {}).items():
        if key.rstrip("/").rsplit("/", 1)[-1] in (node, "**"):
            found |= section.get("ros__parameters") or {}
    return [
        f"launch argument {name}: {value} replaces {found[name]} of {path.name}"
        for name, value in given.items()
        if name in found and found[name] != value
    ]

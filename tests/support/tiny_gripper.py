"""A gripper of two slides and three boxes, as MJCF and as URDF, to be changed by tests."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

MODEL = """<mujoco><worldbody><body name="palm">
  <geom type="box" size="0.05 0.02 0.03"/>
  <body name="left" pos="-0.03 0 0.06">
    <joint name="slide_l" type="slide" axis="1 0 0" range="0 0.03"/>
    <geom name="pad_l" type="box" size="0.004 0.01 0.03"/></body>
  <body name="right" pos="0.03 0 0.06">
    <joint name="slide_r" type="slide" axis="-1 0 0" range="0 0.03"/>
    <geom name="pad_r" type="box" size="0.004 0.01 0.03"/></body>
</body></worldbody>
<actuator><position name="drive" joint="slide_l" kp="2000" kv="40" ctrlrange="0 0.03"/></actuator>
</mujoco>
"""
_LINK = (
    '<link name="{0}"><visual><geometry>{1}</geometry></visual>'
    "<collision><geometry>{1}</geometry></collision></link>\n"
)
_JOINT = (
    '<joint name="slide_{0}" type="prismatic"><parent link="palm"/><child link="{1}"/>'
    '<origin xyz="{2} 0 0.06"/><axis xyz="{3} 0 0"/>'
    '<limit lower="0" upper="0.03" effort="10" velocity="1"/></joint>\n'
)
_PAD = '<box size="0.008 0.02 0.06"/>'
URDF = "".join(
    [
        '<robot name="tiny">\n',
        _LINK.format("palm", '<box size="0.1 0.04 0.06"/>'),
        _LINK.format("left", _PAD),
        _LINK.format("right", _PAD),
        _JOINT.format("l", "left", -0.03, 1),
        _JOINT.format("r", "right", 0.03, -1),
        "</robot>",
    ]
)
_DRIVE = {"kp": 2000, "force": 40, "damping": 20, "armature": 0.1}
GOOD: dict[str, Any] = {
    "format": 1,
    "name": "tiny",
    "display_name": "Tiny",
    "kind": "parallel",
    "model": "model.xml",
    "mount_from_model": {"xyz": [0, 0, 0], "quat": [0, 0, 0, 1]},
    "tcp": [0, 0, 0.08],
    "postures": {
        "open": {"joints": {"slide_l": 0.0, "slide_r": 0.0}},
        "closed": {"joints": {"slide_l": 0.024, "slide_r": 0.024}},
    },
    "actuation": {"slide_l": dict(_DRIVE), "slide_r": dict(_DRIVE)},
    "max_width": 0.052,
    "min_width": 0.0,
    "fingers": [["left"], ["right"]],
    "symmetry": 2,
    "licence": "Apache-2.0",
    "source": "test",
}
Edit = Callable[[dict[str, Any]], object]


def write(
    folder: Path, edit: Edit | None = None, model: str = MODEL, name: str = "model.xml"
) -> Path:
    """Write the gripper with its `gripper.yaml` changed by `edit`; `name` is the model's file."""
    data = copy.deepcopy(GOOD)
    data["model"] = name
    if edit:
        edit(data)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "gripper.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    (folder / name).write_text(model)
    return folder


def put(path: str, value: Any) -> Edit:
    """Return an edit that sets the field at a dotted path."""

    def edit(data: dict[str, Any]) -> None:
        *outer, last = path.split(".")
        for key in outer:
            data = data[key]
        data[last] = value

    return edit

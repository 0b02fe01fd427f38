"""Answers as plain values for JSON."""

from __future__ import annotations

import math
from typing import Any

from megrasp_ros.conversions import numbers_from_pose

POSES = {
    "world_from_tcp": "tcp",
    "world_from_gripper": "pregrasp",
    "world_from_gripper_approach": "approach",
    "world_from_gripper_retreat": "retreat",
}
"""Names of grasps.json -> fields of Grasp.msg."""
NUMBERS = ("score", "width", "width_tolerance", "opening", "clearance", "tilt")


def answer_json(result: Any) -> dict[str, Any]:
    """A result in the form of grasps.json (docs/frames.md); undefined numbers become null."""
    grasps = result.grasps
    return {
        "frame": grasps.header.frame_id,
        "stamp": grasps.header.stamp.sec + 1e-9 * grasps.header.stamp.nanosec,
        "gripper": grasps.gripper,
        "model": grasps.model_id,
        "seed": int(grasps.seed),
        "grasps": [
            {
                **{
                    name: numbers_from_pose(getattr(grasp, field)).tolist()
                    for name, field in POSES.items()
                },
                **{name: _number(getattr(grasp, name)) for name in NUMBERS},
                "object": None if grasp.object < 0 else int(grasp.object),
                "collision_free": bool(grasp.collision_free),
            }
            for grasp in grasps.grasps
        ],
        "rejected": {row.reason: int(row.count) for row in result.rejected},
        "timing": message_json(result.timing),
        **({"notes": list(result.notes)} if result.notes else {}),
    }


def message_json(value: Any) -> Any:
    """Any message, field by field; undefined numbers become null."""
    if hasattr(value, "get_fields_and_field_types"):
        return {
            name: message_json(getattr(value, name)) for name in value.get_fields_and_field_types()
        }
    if isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return _number(value)
    return [message_json(each) for each in value]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None

"""megrasp_msgs is what other programs were promised: every name and type in its order."""

from __future__ import annotations

from pathlib import Path

import megrasp_msgs.action as actions
import megrasp_msgs.msg as messages
import megrasp_msgs.srv as services
import pytest
from megrasp_msgs.msg import ErrorCode

POSE, JOINTS, HEADER = "geometry_msgs/Pose", "sensor_msgs/JointState", "std_msgs/Header"
SYNTHESIS_REQUEST = {
    "num_grasps": "uint32",
    "gripper_name": "string",
    "cloud": "sensor_msgs/PointCloud2",
    "not_before": "builtin_interfaces/Time",
    "region": "megrasp_msgs/OrientedBox",
    "max_tilt": "float",
    "timeout": "float",
    "seed": "uint64",
    "exclude": f"sequence<{POSE}>",
    "exclude_radius": "float",
}
SYNTHESIS_OPTIONS = {
    "target": "int32",
    "min_score": "float",
    "mode": "string",
    "prefer": "string",
}
SYNTHESIS_RESPONSE = {
    "success": "boolean",
    "error_code": "uint16",
    "error_msg": "string",
    "grasps": "megrasp_msgs/GraspArray",
    "timing": "megrasp_msgs/Timing",
    "rejected": "sequence<megrasp_msgs/RejectionCount>",
    "notes": "sequence<string>",
}
EXPECTED = {
    messages.OrientedBox: {"pose": POSE, "size": "geometry_msgs/Vector3"},
    messages.Grasp: {
        "id": "uint32",
        "pregrasp": POSE,
        "tcp": POSE,
        "approach": POSE,
        "pregrasp_posture": JOINTS,
        "grasp_posture": JOINTS,
        "width": "double",
        "score": "float",
        "clearance": "float",
        "tilt": "float",
        "collision_free": "boolean",
        "retreat": POSE,
        "width_tolerance": "double",
        "opening": "double",
        "object": "int32",
    },
    messages.GraspArray: {
        "header": HEADER,
        "gripper": "string",
        "model_id": "string",
        "seed": "uint64",
        "grasps": "sequence<megrasp_msgs/Grasp>",
    },
    messages.GripperInfo: {
        "name": "string",
        "display_name": "string",
        "kind": "string",
        "description_hash": "string",
        "gripper_from_tcp": POSE,
        "joint_names": "sequence<string>",
        "open_positions": "sequence<double>",
        "closed_positions": "sequence<double>",
        "max_width": "double",
        "min_width": "double",
        "seen_in_training": "boolean",
    },
    messages.Timing: dict.fromkeys(
        ("wait", "perceive", "encode", "sample", "check", "total"), "float"
    ),
    messages.RejectionCount: {"reason": "string", "count": "uint32"},
    services.SynthesizeGrasps.Request: {**SYNTHESIS_REQUEST, **SYNTHESIS_OPTIONS},
    services.SynthesizeGrasps.Response: SYNTHESIS_RESPONSE,
    services.DetectBin.Request: {
        "cloud": "sensor_msgs/PointCloud2",
        "size": "geometry_msgs/Vector3",
    },
    services.DetectBin.Response: {
        "success": "boolean",
        "error_code": "uint16",
        "error_msg": "string",
        "bin": "megrasp_msgs/OrientedBox",
        "fill_level": "float",
        "cells": "sequence<float>",
        "rows": "uint32",
        "columns": "uint32",
    },
    services.SetGripper.Request: {"gripper_name": "string", "dry_run": "boolean"},
    services.SetGripper.Response: {
        "success": "boolean",
        "error_code": "uint16",
        "error_msg": "string",
        "gripper": "megrasp_msgs/GripperInfo",
        "available": "sequence<string>",
    },
    services.ListGrippers.Request: {},
    services.ListGrippers.Response: {
        "active": "string",
        "grippers": "sequence<megrasp_msgs/GripperInfo>",
    },
    services.ReloadGrippers.Request: {},
    services.ReloadGrippers.Response: {
        "success": "boolean",
        "error_code": "uint16",
        "error_msg": "string",
        "available": "sequence<string>",
        "failed": "sequence<string>",
    },
    services.ChangeTool.Request: {"gripper_name": "string"},
    services.ChangeTool.Response: {"success": "boolean", "message": "string", "mounted": "string"},
    actions.GenerateGrasps.Goal: {
        **SYNTHESIS_REQUEST,
        "preempt": "boolean",
        **SYNTHESIS_OPTIONS,
    },
    actions.GenerateGrasps.Result: SYNTHESIS_RESPONSE,
    actions.GenerateGrasps.Feedback: {
        "phase": "string",
        "step": "uint32",
        "total_steps": "uint32",
        "elapsed": "float",
        "grasps": "megrasp_msgs/GraspArray",
    },
    actions.ExecuteGrasp.Goal: {
        "header": HEADER,
        "gripper": "string",
        "grasp": "megrasp_msgs/Grasp",
    },
    actions.ExecuteGrasp.Result: {
        "success": "boolean",
        "error_code": "uint16",
        "error_msg": "string",
        "removed": "sequence<string>",
        "objects_left": "uint32",
        "width": "double",
    },
    actions.ExecuteGrasp.Feedback: {"phase": "string"},
}
CODES = {
    "NONE": 0,
    "BUSY": 1,
    "NOT_ACTIVE": 2,
    "CANCELLED": 3,
    "TIMEOUT": 4,
    "INVALID_REQUEST": 5,
    "NO_CLOUD": 100,
    "STALE_CLOUD": 101,
    "BAD_CLOUD": 102,
    "TRANSFORM_OR_GRAVITY_MISSING": 103,
    "EMPTY_REGION": 104,
    "UNKNOWN_GRIPPER": 200,
    "BAD_DESCRIPTION": 201,
    "TOOL_CHANGE_FAILED": 202,
    "TOOL_MISMATCH": 203,
    "MODEL_NOT_LOADED": 300,
    "OUT_OF_MEMORY": 301,
    "INTERNAL": 302,
    "NO_GRASP_FOUND": 400,
    "BIN_EMPTY": 401,
}
SOURCE = Path(__file__).parents[2] / "ros2_ws" / "src" / "megrasp_msgs"


@pytest.mark.parametrize("kind", EXPECTED, ids=lambda kind: kind.__name__)
def test_fields_are_those_promised(kind: type) -> None:
    fields = {
        name: spec
        for name, spec in kind.get_fields_and_field_types().items()
        if not name.startswith("_")
    }
    assert list(fields.items()) == list(EXPECTED[kind].items())


@pytest.mark.parametrize(("name", "value"), CODES.items())
def test_error_codes_are_those_promised(name: str, value: int) -> None:
    assert getattr(ErrorCode, name) == value


def test_defaults_are_those_promised() -> None:
    for request in (services.SynthesizeGrasps.Request(), actions.GenerateGrasps.Goal()):
        assert (request.num_grasps, request.seed, request.cloud.width) == (20, 0, 0)
        assert (request.max_tilt, request.timeout) == (0.0, 0.0)
        assert request.exclude_radius == pytest.approx(0.02)
        assert (request.target, request.min_score, request.mode, request.prefer) == (-1, 0, "", "")
    assert services.SetGripper.Request().dry_run is False


def test_every_field_and_constant_is_documented() -> None:
    files = sorted(
        path for path in SOURCE.rglob("*.*") if path.suffix in (".msg", ".srv", ".action")
    )
    assert len(files) == 15
    for file in files:
        for line in file.read_text().splitlines():
            if line.strip() and line != "---" and not line.startswith("#"):
                assert "#" in line, f"{file.name}: {line!r} has no comment"

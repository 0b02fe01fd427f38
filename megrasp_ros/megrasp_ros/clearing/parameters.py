"""Parameters of `bin_clearing`, with descriptions and ranges; all are read once, at the start."""

from __future__ import annotations

from dataclasses import dataclass

from megrasp_msgs.msg import OrientedBox
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from megrasp_core.errors import InvalidRequestError


@dataclass(frozen=True)
class ClearingParameters:
    """See `declare_clearing_parameters`."""

    grippers: list[str]
    num_objects: int
    tries: int
    num_grasps: int
    seed: int
    region: OrientedBox
    out: str
    pictures: bool
    ready_timeout: float
    call_timeout: float


def declare_clearing_parameters(node: Node) -> ClearingParameters:
    """Declares and reads them. Raises InvalidRequestError for a region that is no box."""

    def declare(name: str, default, description: str, **limits):
        descriptor = ParameterDescriptor(description=description, read_only=True, **limits)
        return node.declare_parameter(name, default, descriptor).value

    def seconds(name: str, default: float, description: str) -> float:
        limit = FloatingPointRange(from_value=0.1, to_value=3600.0)
        return declare(name, default, description, floating_point_range=[limit])

    def whole(name: str, default: int, low: int, high: int, description: str) -> int:
        limit = IntegerRange(from_value=low, to_value=high, step=0)
        return declare(name, default, description, integer_range=[limit])

    return ClearingParameters(
        grippers=list(
            declare(
                "grippers",
                ["robotiq_2f85", "robotiq_3f"],
                "grippers in the order of use; each takes an equal share of the objects",
            )
        ),
        num_objects=whole("num_objects", 8, 1, 1000, "objects in the bin at the start"),
        tries=whole("tries", 3, 1, 100, "failures in a row after which an object is given up"),
        num_grasps=whole("num_grasps", 20, 1, 10000, "grasps asked for before every pick"),
        seed=whole("seed", 1, 1, 2**31 - 1, "the n-th synthesis uses seed + n"),
        region=_region(
            declare(
                "region.pose",
                [0.0, 0.0, 0.075, 0.0, 0.0, 0.0, 1.0],
                "centre of the bin's inside: x y z qx qy qz qw",
            ),
            declare(
                "region.size",
                [0.40, 0.30, 0.15],
                "full inner edges of the bin (m); all 0: what grasp_server has",
            ),
        ),
        out=declare("out", "out/demo", "folder for pictures and summary.json"),
        pictures=declare(
            "pictures", True, "leave a picture before every pick and a contact sheet"
        ),
        ready_timeout=seconds("ready_timeout", 60.0, "longest wait for the other nodes (s)"),
        call_timeout=seconds("call_timeout", 120.0, "longest wait for one answer (s)"),
    )


def _region(pose, size) -> OrientedBox:
    if len(pose) != 7 or len(size) != 3:
        raise InvalidRequestError(
            f"region.pose has {len(pose)} and region.size {len(size)} numbers; expected 7 (x y z "
            "qx qy qz qw) "
            "and 3 (full edges, m)"
        )
    box = OrientedBox()
    box.pose.position.x, box.pose.position.y, box.pose.position.z = map(float, pose[:3])
    orientation = box.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = map(float, pose[3:])
    box.size.x, box.size.y, box.size.z = map(float, size)
    return box

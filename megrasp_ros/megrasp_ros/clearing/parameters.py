"""Parameters of `bin_clearing`, with descriptions and ranges; all are read once, at the start."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from megrasp_msgs.msg import OrientedBox
from rclpy.node import Node

from megrasp_core.errors import InvalidRequestError
from megrasp_ros.declaring import declare_once


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
    record: str
    record_limit: int


def declare_clearing_parameters(node: Node) -> ClearingParameters:
    """Declares and reads them. Raises InvalidRequestError for a region that is no box."""
    declare = functools.partial(declare_once, node)
    return ClearingParameters(
        grippers=list(
            declare(
                "grippers",
                ["robotiq_2f85", "robotiq_3f"],
                "grippers in the order of use; each takes an equal share of the objects",
            )
        ),
        num_objects=declare("num_objects", 8, "objects in the bin at the start", low=1, high=1000),
        tries=declare(
            "tries", 3, "failures in a row after which an object is given up", low=1, high=100
        ),
        num_grasps=declare(
            "num_grasps", 20, "grasps asked for before every pick", low=1, high=10000
        ),
        seed=declare("seed", 1, "the n-th synthesis uses seed + n", low=1, high=2**31 - 1),
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
        ready_timeout=declare(
            "ready_timeout", 60.0, "longest wait for the other nodes (s)", low=0.1, high=3600.0
        ),
        call_timeout=declare(
            "call_timeout", 120.0, "longest wait for one answer (s)", low=0.1, high=3600.0
        ),
        record=declare(
            "record", "", "folder that every attempt is written to (docs/attempts.md); empty: none"
        ),
        record_limit=declare(
            "record_limit",
            2000,
            "most megabytes in that folder; the oldest attempts go",
            low=1,
            high=10**7,
        ),
    )


def _region(pose: list[float], size: list[float]) -> OrientedBox:
    if len(pose) != 7 or len(size) != 3:
        raise InvalidRequestError(
            f"region.pose has {len(pose)} and region.size {len(size)} numbers; expected 7 (x y z "
            "qx qy qz qw) and 3 (full edges, m)"
        )
    box = OrientedBox()
    box.pose.position.x, box.pose.position.y, box.pose.position.z = map(float, pose[:3])
    orientation = box.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = map(float, pose[3:])
    box.size.x, box.size.y, box.size.z = map(float, size)
    return box

"""Parameters of `sim_cell`, with descriptions and ranges; all are read once, at the start."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from rclpy.node import Node

from megrasp_core.errors import InvalidRequestError
from megrasp_ros.declaring import declare_once

FRAMES = ("cell", "optical")


@dataclass(frozen=True)
class CellParameters:
    """See `declare_cell_parameters`."""

    seed: int
    num_objects: int
    objects_dir: str
    grippers: list[str]
    gripper: str
    cloud_rate: float
    frame: str
    publish_clock: bool


def declare_cell_parameters(node: Node) -> CellParameters:
    """Declares and reads them. Raises InvalidRequestError for a frame that does not exist."""
    declare = functools.partial(declare_once, node)
    parameters = CellParameters(
        seed=declare(
            "seed",
            1,
            "seed of objects, their places and the camera's noise",
            low=0,
            high=2**31 - 1,
        ),
        num_objects=declare("num_objects", 8, "objects in the bin at the start", low=1, high=40),
        objects_dir=declare(
            "objects_dir", "", "folder of object folders to draw from; empty: procedural objects"
        ),
        grippers=list(
            declare(
                "grippers", ["robotiq_2f85", "robotiq_3f"], "rack: registered names or folders"
            )
        ),
        gripper=declare("gripper", "", "gripper at the start; empty: the first of the rack"),
        cloud_rate=declare(
            "cloud_rate", 2.0, "clouds per second while somebody listens (Hz)", low=0.1, high=30.0
        ),
        frame=declare(
            "frame",
            "cell",
            f"frame of `points`, one of {', '.join(FRAMES)}; optical: the camera's frame",
        ),
        publish_clock=declare(
            "publish_clock", False, "publish /clock, for nodes with use_sim_time"
        ),
    )
    if parameters.frame not in FRAMES:
        raise InvalidRequestError(
            f"frame {parameters.frame!r} was given; expected one of {', '.join(FRAMES)}"
        )
    return parameters

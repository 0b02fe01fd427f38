"""Parameters of `sim_cell`, with descriptions and ranges; all are read once, at the start."""

from __future__ import annotations

from dataclasses import dataclass

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from megrasp_core.errors import InvalidRequestError

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


def declare_cell_parameters(node: Node) -> CellParameters:
    """Declares and reads them. Raises InvalidRequestError for a frame that does not exist."""

    def declare(name: str, default, description: str, **limits):
        descriptor = ParameterDescriptor(description=description, read_only=True, **limits)
        return node.declare_parameter(name, default, descriptor).value

    parameters = CellParameters(
        seed=declare(
            "seed",
            1,
            "seed of objects, their places and the camera's noise",
            integer_range=[IntegerRange(from_value=0, to_value=2**31 - 1, step=0)],
        ),
        num_objects=declare(
            "num_objects",
            8,
            "objects in the bin at the start",
            integer_range=[IntegerRange(from_value=1, to_value=40, step=0)],
        ),
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
            "cloud_rate",
            2.0,
            "clouds per second while somebody listens (Hz)",
            floating_point_range=[FloatingPointRange(from_value=0.1, to_value=30.0)],
        ),
        frame=declare(
            "frame",
            "cell",
            f"frame of `points`, one of {', '.join(FRAMES)}; optical: the camera's frame",
        ),
    )
    if parameters.frame not in FRAMES:
        raise InvalidRequestError(
            f"frame {parameters.frame!r} was given; expected one of {', '.join(FRAMES)}"
        )
    return parameters

"""What commands that read a cloud ask of how it was seen: frame, gravity, sensor, units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from megrasp_core.errors import GravityError, InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud

__all__ = ["Vector", "gravity_of", "length_factor", "sensor_of"]

Vector = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]


def gravity_of(
    frame: str, gravity: tuple[float, float, float] | None, top_down: bool
) -> tuple[float, float, float]:
    """The vector that points down in the frame of the cloud, from --frame, --gravity, --top-down.

    Raises:
        InvalidRequestError: the options contradict each other.
        GravityError: the frame is a camera's and nothing says where down is.
    """
    if top_down and frame != "optical":
        raise InvalidRequestError(
            "--top-down was given with --frame world; expected it with --frame optical only. In a "
            "world frame gravity is 0 0 -1, or what --gravity says."
        )
    if top_down and gravity is not None:
        raise InvalidRequestError("--top-down and --gravity were given; expected one of them.")
    if gravity is not None:
        return gravity
    if frame == "world":
        return (0.0, 0.0, -1.0)
    if top_down:
        return (0.0, 0.0, 1.0)
    raise GravityError(
        "--frame optical was given without gravity; expected --gravity X Y Z, a vector that "
        "points down in the camera's frame (x right, y down, z forward). Add --gravity X Y Z, or "
        "--top-down where the camera looks straight down."
    )


def length_factor(scale: float) -> float:
    """Metres per unit of a file, from --scale.

    Raises:
        InvalidRequestError: it is not a number over 0.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise InvalidRequestError(
            f"--scale {scale} was given; expected metres per unit of the file, for example 0.001 "
            "for millimetres."
        )
    return scale


def sensor_of(
    cloud: Cloud, frame: str, sensor: tuple[float, float, float] | None
) -> np.ndarray | None:
    """Where the cloud was seen from, (3,) or (N, 3): --sensor, the file's viewpoint, or the origin
    of a camera's frame; None where nobody says.
    """
    if sensor is not None:
        return np.asarray(sensor)
    if cloud.viewpoint is not None:
        return cloud.viewpoint
    return np.zeros(3) if frame == "optical" else None

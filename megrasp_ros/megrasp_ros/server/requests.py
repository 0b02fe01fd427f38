"""A synthesis request, checked: from the service, the action or auto_synthesize."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.srv import SynthesizeGrasps
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import InvalidRequestError
from megrasp_ros.conversions import box_from_message, matrices_from_poses
from megrasp_ros.errors import MOST_TEXT, shortened

from .parameters import Settings

if TYPE_CHECKING:
    from megrasp_core.pointcloud import OrientedBox


@dataclass(frozen=True)
class ParsedRequest:
    """What to compute. Poses and region are in the planning frame; fields as in
    SynthesizeGrasps.srv.
    """

    num_grasps: int
    seed: int
    max_tilt: float
    timeout: float
    region: OrientedBox | None
    gripper_name: str = ""
    cloud: PointCloud2 | None = None
    not_before: Time = field(default_factory=Time)
    exclude: Sequence[Pose] = ()
    exclude_radius: float = 0.02
    target: int | None = None
    min_score: float = 0.0
    mode: str = "default"
    prefer: str = "score"

    def excluded(self, check: Callable[[], None]) -> NDArray[np.float64]:
        """Return the TCP poses (E, 4, 4) to leave out; `check` is called meanwhile and may raise.

        Raises InvalidRequestError, too.
        """
        return matrices_from_poses(self.exclude, "exclude", check)


def checked_request(
    message: SynthesizeGrasps.Request | GenerateGrasps.Goal, settings: Settings
) -> ParsedRequest:
    """Return the request with the parameters filled in for what it leaves open.

    Only what costs no time is looked at; clouds and excluded poses are the worker's business.
    Raises InvalidRequestError when a field is out of its range.
    """
    if not 1 <= message.num_grasps <= settings.max_num_grasps:
        raise InvalidRequestError(
            f"num_grasps is {message.num_grasps}; expected 1 to {settings.max_num_grasps}, the "
            "parameter max_num_grasps. Ask for fewer, or raise the parameter."
        )
    # pi as float32 is a little over pi.
    _in_range("max_tilt", message.max_tilt, math.pi + 1e-6, "rad; 0: the parameter max_tilt")
    _in_range("timeout", message.timeout, 3600.0, "s; 0: the parameter request_timeout")
    _in_range("exclude_radius", message.exclude_radius, 10.0, "m")
    if message.not_before.sec < 0:
        raise InvalidRequestError(
            f"not_before.sec is {message.not_before.sec}; expected a time, or 0 for any cloud."
        )
    _in_range("min_score", message.min_score, 1.0, "a probability; 0: the parameter min_score")
    _one_of("mode", message.mode, "default", "fast")
    _one_of("prefer", message.prefer, "score", "high", "clear")
    if message.target < -1 or message.target == 0:
        raise InvalidRequestError(
            f"target is {message.target}; expected the number of an object in the mask, from 1, "
            "or -1 for any."
        )
    region = box_from_message(message.region)
    return ParsedRequest(
        num_grasps=int(message.num_grasps),
        seed=int(message.seed) or random_seed(),
        max_tilt=min(float(message.max_tilt), math.pi) or settings.max_tilt,
        timeout=float(message.timeout) or settings.request_timeout,
        region=region if region is not None else settings.region,
        gripper_name=message.gripper_name,
        cloud=message.cloud if message.cloud.width else None,
        not_before=message.not_before,
        exclude=message.exclude,
        exclude_radius=float(message.exclude_radius),
        target=None if message.target == -1 else int(message.target),
        min_score=float(message.min_score) or settings.min_score,
        mode=message.mode or "default",
        prefer=message.prefer or settings.prefer,
    )


def automatic_request(settings: Settings) -> ParsedRequest:
    """Return the request of auto_synthesize: everything from the parameters."""
    return ParsedRequest(
        num_grasps=min(settings.num_grasps, settings.max_num_grasps),
        seed=random_seed(),
        max_tilt=settings.max_tilt,
        timeout=settings.request_timeout,
        region=settings.region,
        min_score=settings.min_score,
        prefer=settings.prefer,
    )


def random_seed() -> int:
    """Return a seed over 0, short enough to be typed again."""
    return secrets.randbits(31) + 1


def _in_range(name: str, value: float, high: float, meaning: str) -> None:
    if not 0.0 <= value <= high:
        raise InvalidRequestError(f"{name} is {value}; expected 0 to {high:.5g} ({meaning}).")


def _one_of(name: str, value: str, *choices: str) -> None:
    if value not in ("", *choices):
        raise InvalidRequestError(
            f"{name} is {shortened(value, MOST_TEXT)!r}; expected one of {', '.join(choices)}, "
            "or empty."
        )

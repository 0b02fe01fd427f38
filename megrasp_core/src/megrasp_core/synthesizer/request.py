"""What a caller asks for, checked before any work is done."""

from __future__ import annotations

import math
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from megrasp_core.errors import GravityError, InvalidRequestError
from megrasp_core.limits import MAX_DRAWN, MAX_GRASPS
from megrasp_core.pointcloud import OrientedBox, Plane, level_floor

__all__ = ["LAYER", "MAX_DRAWN", "MAX_GRASPS", "Mode", "Prefer", "SynthesisRequest"]

Mode = Literal["default", "fast"]
Prefer = Literal["score", "high", "clear"]

LAYER = 0.02
"""Grasps whose heights differ by less (m) are equally high."""

Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True, kw_only=True)
class SynthesisRequest:
    """What is asked of one synthesis: the one place of its options and their defaults.

    Attributes:
        num_grasps: most grasps to return, 1 to `MAX_GRASPS`.
        drawn: poses to draw, 1 to `MAX_DRAWN`; at least num_grasps are.
        mode: `default`: all drawn go through the descent, the best `refined` through the
            restarts; `fast`: num_grasps are drawn and all go through everything.
        gravity: (3,) vector that points down in the cloud's frame; None where unknown.
        sensor: (3,) where the sensor was, or (N, 3) for every point; None: the cloud's viewpoint.
        region: only points in it count.
        walls: the region is the inside of a bin: its sides are walls, its bottom the floor.
        floor: the surface that the objects lie on, where it is known: a plane, or its height over
            the origin against gravity (m). Used where the cloud does not show it.
        assume_empty: where nothing was seen there is floor or, in a bin, wall. Without it that is
            said only of a floor that shows almost nowhere, and small patches stay unknown.
        max_tilt: largest angle between gripper +Z and gravity (rad).
        approach_distance: between pre-grasp and approach pose (m).
        approach_direction: back along gripper -Z (`tool`) or up (`gravity`).
        exclude: (E, 4, 4) TCP poses that failed before.
        exclude_radius: how near to them a grasp counts as the same (m).
        seed: of everything drawn; None: a random one, which the result states.
        keep_all: return the poses that fail the check as well, last, up to num_grasps in all.
        target: only grasps of the object with this label of the cloud; the others are obstacles.
        min_score: grasps below this score are not returned.
        prefer: what comes first of the grasps that pass the check: the best `score`; `high`: the
            highest against gravity, within `LAYER` the best score; `clear`: the most clearance.

    Raises:
        InvalidRequestError: an argument is outside its range.
        GravityError: gravity is no direction, or is needed and not given.
    """

    num_grasps: int = 20
    drawn: int = 100
    mode: Mode = "default"
    gravity: Vector | None = (0.0, 0.0, -1.0)
    sensor: Vector | None = None
    region: OrientedBox | None = None
    walls: bool = True
    floor: Plane | float | None = None
    assume_empty: bool = False
    max_tilt: float | None = None
    approach_distance: float = 0.10
    approach_direction: Literal["tool", "gravity"] = "tool"
    exclude: Sequence[np.ndarray] | np.ndarray = ()
    exclude_radius: float = 0.02
    seed: int | None = None
    keep_all: bool = False
    target: int | None = None
    min_score: float = 0.0
    prefer: Prefer = "score"

    @classmethod
    def of(cls, **options: Any) -> SynthesisRequest:
        """A request of options by name.

        Raises:
            InvalidRequestError: there is no such option; the message lists those that there are.
        """
        names = [field.name for field in fields(cls)]
        unknown = sorted(set(options) - set(names))
        if unknown:
            raise InvalidRequestError(
                f"options {unknown} were given; expected some of {', '.join(names)}."
            )
        return cls(**options)

    def __post_init__(self) -> None:
        """Check every argument and bring the arrays to float64."""
        n = _whole("num_grasps", self.num_grasps, 1, MAX_GRASPS, "Ask for fewer grasps.")
        drawn = _whole("drawn", self.drawn, 1, MAX_DRAWN, "Draw fewer poses.")
        if self.mode not in ("default", "fast"):
            raise InvalidRequestError(
                f"mode {self.mode!r} was given; expected 'default' or 'fast'."
            )
        # More cannot be returned than are drawn, and `fast` draws what it returns.
        self._set("num_grasps", n)
        self._set("drawn", n if self.mode == "fast" else max(drawn, n))
        self._set("gravity", _direction(_array("gravity", self.gravity)))
        self._set("sensor", _array("sensor", self.sensor))
        if self.region is not None:
            self.region.check_units()
        self._set("floor", _floor(self.floor, self.gravity))
        if self.max_tilt is not None and not 0 < self.max_tilt <= math.pi:
            raise InvalidRequestError(
                f"max_tilt {self.max_tilt} was given; expected an angle over 0 and up to pi "
                "(rad), or none."
            )
        if not 0 <= self.approach_distance <= 1:
            raise InvalidRequestError(
                f"approach_distance {self.approach_distance} was given; expected 0 to 1 m."
            )
        if self.approach_direction not in ("tool", "gravity"):
            raise InvalidRequestError(
                f"approach_direction {self.approach_direction!r} was given; expected 'tool' or "
                "'gravity'."
            )
        if self.prefer not in ("score", "high", "clear"):
            raise InvalidRequestError(
                f"prefer {self.prefer!r} was given; expected 'score', 'high' or 'clear'."
            )
        if not 0 <= self.min_score <= 1:
            raise InvalidRequestError(
                f"min_score {self.min_score} was given; expected a probability, 0 to 1."
            )
        if self.target is not None:
            advice = "Give a label of the mask."
            self._set("target", _whole("target", self.target, 1, 2**31 - 1, advice))
        if self.gravity is None and (
            self.approach_direction == "gravity"
            or self.max_tilt is not None
            or self.prefer == "high"
        ):
            raise GravityError(
                "the direction of gravity is not known; expected a vector that points down in the "
                "frame of the cloud, because an approach along gravity, a largest tilt or the "
                "highest grasps first were asked for. Give gravity."
            )
        if not (np.isfinite(self.exclude_radius) and self.exclude_radius >= 0):
            raise InvalidRequestError(
                f"exclude_radius {self.exclude_radius} was given; expected a length of at least 0 "
                "m."
            )
        self._set("exclude", _poses(self.exclude))
        if self.seed is None:
            self._set("seed", secrets.randbits(32))
        else:
            self._set("seed", _whole("seed", self.seed, 0, 2**63 - 1, "Give another one."))

    def moved(self, offset: np.ndarray) -> SynthesisRequest:
        """The same request for a cloud that was moved by `offset` (3,) (m)."""
        pose = np.eye(4)
        pose[:3, 3] = offset
        floor, exclude = self.floor, np.array(self.exclude)
        exclude[:, :3, 3] += offset
        assert not isinstance(floor, (int, float))  # a plane since it was checked
        return replace(
            self,
            sensor=None if self.sensor is None else np.asarray(self.sensor) + offset,
            region=None if self.region is None else self.region.transformed(pose),
            floor=None if floor is None else floor.moved(offset),
            exclude=exclude,
        )

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)


def _array(name: str, value: Vector | None) -> np.ndarray | None:
    if value is None:
        return None
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"{name} {value!r} was given ({error}); expected numbers, for example (0, 0, -1)."
        ) from None


def _whole(name: str, value: object, low: int, high: int, advice: str) -> int:
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, np.integer))
        or not low <= value <= high
    ):
        raise InvalidRequestError(
            f"{name} {value!r} was given; expected a whole number from {low} to {high}. {advice}"
        )
    return int(value)


def _direction(vector: np.ndarray | None) -> np.ndarray | None:
    if vector is None:
        return None
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
    if not math.isfinite(length) or length < 1e-6:
        raise GravityError(
            f"gravity {vector.tolist()} was given; expected three numbers that point down in the "
            "frame of the cloud, for example 0 0 -1 where z is up."
        )
    return vector / length


def _floor(floor: Plane | float | None, gravity: Vector | None) -> Plane | None:
    if floor is None or isinstance(floor, Plane):
        return floor
    if isinstance(floor, bool) or not isinstance(floor, (int, float)) or not math.isfinite(floor):
        raise InvalidRequestError(
            f"floor {floor!r} was given; expected a height (m), a Plane, or none."
        )
    return level_floor(floor, None if gravity is None else np.asarray(gravity))


def _poses(poses: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    stack = np.asarray(poses, dtype=np.float64)
    if stack.size == 0:
        return np.zeros((0, 4, 4))
    if stack.shape == (4, 4):
        stack = stack[None]
    if stack.ndim != 3 or stack.shape[1:] != (4, 4) or not np.isfinite(stack).all():
        raise InvalidRequestError(
            f"exclude has shape {stack.shape}; expected (E, 4, 4) finite TCP poses. Give "
            "world_from_tcp of the grasps that failed."
        )
    return stack

"""What a caller asks for, checked before any work is done."""

from __future__ import annotations

import math
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from megrasp_core.errors import CloudError, GravityError, InvalidRequestError
from megrasp_core.limits import MAX_DRAWN, MAX_GRASPS
from megrasp_core.pointcloud import OrientedBox, Plane, level_floor, unit_gravity
from megrasp_core.ranges import ANY, SHARE, Range, check_ranges

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
        more_rounds: in mode `default`, while no grasp that passes has the score
            `SynthesizerSettings.sure`, as many poses are drawn once more, at most so often.
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
        InvalidRequestError: an argument is of another type or outside its range.
        CloudError: the sensor is no place.
        GravityError: gravity is no direction, or is needed and not given.
    """

    num_grasps: int = 20
    drawn: int = 100
    mode: Mode = "default"
    more_rounds: int = 3
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
        check_ranges(
            self,
            num_grasps=Range(1, MAX_GRASPS, whole=True, advice="Ask for fewer grasps."),
            drawn=Range(1, MAX_DRAWN, whole=True, advice="Draw fewer poses."),
            more_rounds=Range(0, 100, whole=True),
            max_tilt=Range(high=math.pi, above=0, optional=True, unit="rad"),
            approach_distance=Range(0, 1, unit="m"),
            exclude_radius=Range(0, unit="m"),
            seed=Range(0, 2**63 - 1, whole=True, optional=True),
            target=Range(
                1, 2**31 - 1, whole=True, optional=True, advice="Give a label of the mask."
            ),
            min_score=SHARE,
        )
        _one_of("mode", self.mode, get_args(Mode))
        _one_of("approach_direction", self.approach_direction, ("tool", "gravity"))
        _one_of("prefer", self.prefer, get_args(Prefer))
        for name in ("walls", "assume_empty", "keep_all"):
            self._set(name, _yes_or_no(name, getattr(self, name)))
        n = int(self.num_grasps)
        # More cannot be returned than are drawn, and `fast` draws what it returns.
        self._set("num_grasps", n)
        self._set("drawn", n if self.mode == "fast" else max(int(self.drawn), n))
        if self.gravity is not None:
            self._set("gravity", unit_gravity(_numbers("gravity", self.gravity)))
        self._set("sensor", _places(self.sensor))
        if self.region is not None:
            if not isinstance(self.region, OrientedBox):
                raise InvalidRequestError(
                    f"region {_short(self.region)} was given; expected an OrientedBox, or none."
                )
            self.region.check_units()
        self._set("floor", _floor(self.floor, self.gravity))
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
        self._set("exclude", _poses(self.exclude))
        self._set("seed", secrets.randbits(32) if self.seed is None else int(self.seed))
        self._set("target", None if self.target is None else int(self.target))

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


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]}..."


def _one_of(name: str, value: object, known: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in known:
        *others, last = map(repr, known)
        raise InvalidRequestError(
            f"{name} {_short(value)} was given; expected {', '.join(others)} or {last}."
        )


def _yes_or_no(name: str, value: object) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidRequestError(f"{name} {_short(value)} was given; expected true or false.")
    return bool(value)


def _numbers(name: str, value: object) -> np.ndarray:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise InvalidRequestError(
            f"{name} {_short(value)} was given; expected numbers, for example (0, 0, -1)."
        )
    return array.astype(np.float64)


def _places(value: Vector | None) -> np.ndarray | None:
    if value is None:
        return None
    places = _numbers("sensor", value)
    if places.ndim not in (1, 2) or places.shape[-1] != 3:
        raise CloudError(
            f"the sensor's place has the shape {places.shape}; expected three finite numbers (x, "
            "y, z) in the cloud's frame, or (N, 3), one place for each point."
        )
    return places


def _floor(floor: Plane | float | None, gravity: Vector | None) -> Plane | None:
    if floor is None or isinstance(floor, Plane):
        return floor
    if not ANY.takes(floor):
        raise InvalidRequestError(
            f"floor {_short(floor)} was given; expected a height (m), a Plane, or none."
        )
    return level_floor(float(floor), None if gravity is None else np.asarray(gravity))


def _poses(poses: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    stack = _numbers("exclude", poses)
    if stack.ndim and stack.size == 0:
        return np.zeros((0, 4, 4))
    if stack.shape == (4, 4):
        stack = stack[None]
    if stack.ndim != 3 or stack.shape[1:] != (4, 4) or not np.isfinite(stack).all():
        raise InvalidRequestError(
            f"exclude has shape {stack.shape}; expected (E, 4, 4) finite TCP poses. Give "
            "world_from_tcp of the grasps that failed."
        )
    return stack

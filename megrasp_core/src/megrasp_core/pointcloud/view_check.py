"""Units, frame and gravity of a cloud, checked before any work is spent on it.

A cloud in millimetres, in a camera's axes that nobody named, or with the vector of an
accelerometer for gravity has the right form and leads to no grasps, or to grasps from below. What
gives it away is where the sensor is: some decimetres away from a scene of some decimetres, and
not below it.
"""

from __future__ import annotations

from itertools import starmap

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import CloudError, GravityError

from .box import OrientedBox
from .sensor import sensor_place

FloatArray = NDArray[np.float64]

SAMPLE = 20_000
"""So many points decide."""
LARGEST = 10.0
"""No scene for a gripper is as wide as this, or as far from its sensor (m)."""
SMALLEST = 0.003
"""No scene is as narrow as this (m)."""
COARSEST = 0.0005
"""Steps of coordinates (m) above which the shape of objects is lost."""
LEAST_VIEW = 0.02
"""Sensors that saw a smaller share of the points decide nothing."""
SENTINELS = 0.2
"""Marks of pixels without a reading are fewer than this, or nobody looked at the cloud."""
UPWARDS = 0.17
"""Sine of the angle by which a sensor may look up: a camera beside a low shelf."""

AT_ORIGIN = 0.05
"""A sensor this near to the origin (m) may be in a frame of its own."""

UNITS = {"millimetres": (0.001, 0.0), "centimetres": (0.01, 0.5), "inches": (0.0254, 0.3)}
"""Metres per unit, and how much less often the unit is met than millimetres."""
USUAL_WIDTH = (0.1, 1.5)
USUAL_DISTANCE = (0.25, 2.0)
"""Of scenes for grippers and of sensors from them (m)."""


def check_view(
    points: FloatArray,
    *,
    sensor: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    region: OrientedBox | None = None,
    optical: bool = False,
) -> None:
    """Refuse a cloud whose units, frame or gravity cannot be what they are said to be.

    Args:
        points: (N, 3), rows that are not finite count for nothing.
        sensor: (3,) in the same frame, or (N, 3), each place looked at on its own; None where
            unknown.
        gravity: (3,) of any length; None where unknown.
        region: where it holds points, they alone decide: what lies around may be a whole hall.
        optical: the frame is said to be a camera's: x right, y down, z forward.

    Raises:
        CloudError: a sensor's place of another shape; other units than metres; too far from the
            origin for the precision of the numbers; points behind the camera.
        GravityError: the sensor would lie below what it sees.
    """
    rows = _deciding(points, region)
    if not len(rows):
        return
    sample = np.asarray(points, dtype=np.float64)[rows]
    views: list[tuple[FloatArray, FloatArray]] = []
    if sensor is not None:
        place = sensor_place(sensor, len(points))
        views = [(sample, place)] if place.ndim == 1 else _views(sample, place[rows])
    _check_units(sample, views[0][1] if len(views) == 1 else None)
    _check_steps(sample)
    if optical:
        _check_in_front(sample)
    for seen, place in views:
        if len(views) > 1:
            _check_units(seen, place)
        if gravity is not None:
            _check_looks_down(seen, place, np.asarray(gravity, dtype=np.float64))


def _deciding(points: FloatArray, region: OrientedBox | None) -> NDArray[np.intp]:
    """Rows of finite points."""
    points = np.asarray(points, dtype=np.float64)
    rows = np.arange(len(points))
    if region is not None:
        inside = np.flatnonzero(region.contains(points))
        rows = inside if len(inside) >= 30 else rows
    rows = rows[:: max(1, len(rows) // SAMPLE)]
    return rows[np.isfinite(points[rows]).all(axis=1)]


def _views(sample: FloatArray, places: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """The points of each place that sees a good part of them; of a moving one, all together."""
    found, of, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    of = of.ravel()
    large = [i for i in range(len(found)) if count[i] >= LEAST_VIEW * len(sample)]
    if not large:
        return [(sample, places.mean(axis=0))]
    return [(sample[of == i], found[i]) for i in large]


def _check_units(sample: FloatArray, sensor: FloatArray | None) -> None:
    low, high = np.percentile(sample, (2, 98), axis=0)
    width = float((high - low).max())
    distance = None if sensor is None else float(np.linalg.norm(np.median(sample, 0) - sensor))
    sizes = f"{width:.3g} wide"
    if distance is not None:
        sizes += f" and {distance:.3g} from the sensor"
    if width <= LARGEST and (distance or 0.0) > LARGEST and width > USUAL_WIDTH[0] / 2:
        assert sensor is not None
        raise CloudError(
            f"the cloud is {width:.3g} m wide and its sensor, at {_numbers(sensor)}, is "
            f"{distance:.3g} m away; expected both in metres and in one frame. Check where the "
            "sensor is said to be (--sensor, the file's viewpoint). If the cloud is in other "
            "units as well, scale both (--scale)."
        )
    if width > LARGEST and (stray := _stray(sample)):
        raise CloudError(
            f"the cloud is {sizes}, and {100 * stray:.0f} % of its points lie far away from the "
            "others; expected a scene. They look like marks of pixels without a reading: take "
            "them out, or give the region that the objects lie in."
        )
    if max(width, distance or 0.0) > LARGEST:
        unlikely = {name: _unlikely(width, distance, *unit) for name, unit in UNITS.items()}
        least = min(unlikely.values())
        near = [name for name in UNITS if unlikely[name] < least + 0.3]
        guesses = " or ".join(
            f"{name}: scale it by {UNITS[name][0]} (--scale {UNITS[name][0]})" for name in near
        )
        raise CloudError(
            f"the cloud is {sizes}; expected metres. It looks like {guesses}. If it is metres, "
            "give the region that the objects lie in."
        )
    if width < SMALLEST:
        raise CloudError(
            f"the cloud is {sizes}; expected metres, and at least {1000 * SMALLEST:.0f} mm of a "
            "scene. Scale it (--scale), or check what the camera sees."
        )


def _stray(sample: FloatArray) -> float:
    """Share of points far from the others, 0 where that explains nothing."""
    middle = np.median(sample, axis=0)
    away = np.linalg.norm(sample - middle, axis=1)
    far = away > LARGEST
    share = float(far.mean())
    return share if 0.0 < share < SENTINELS and away[~far].max() < 0.1 * away[far].min() else 0.0


def _unlikely(width: float, distance: float | None, scale: float, rareness: float) -> float:
    sizes = [(width, USUAL_WIDTH)] + ([] if distance is None else [(distance, USUAL_DISTANCE)])

    def outside(size: float, usual: tuple[float, float]) -> float:
        size = max(scale * size, 1e-9)
        middle = np.sqrt(usual[0] * usual[1])
        beyond = max(np.log(usual[0] / size), np.log(size / usual[1]), 0.0)
        return float(beyond + 0.1 * abs(np.log(size / middle)))

    return rareness + sum(starmap(outside, sizes))


def _check_steps(sample: FloatArray) -> None:
    farthest = float(np.abs(sample).max())
    step = float(np.spacing(np.float32(farthest)))
    if step > COARSEST and (sample == sample.astype(np.float32)).all():
        raise CloudError(
            f"the cloud has coordinates of {farthest:.3g} m in numbers of 32 bits, which are "
            f"{1000 * step:.3g} mm apart there; expected the shape of objects. Subtract a point "
            "near the scene before the cloud is stored, or store 64 bits."
        )


def _check_in_front(sample: FloatArray) -> None:
    behind = int(np.count_nonzero(sample[:, 2] <= 0.0))
    if behind <= 0.1 * len(sample):
        return
    share = "all" if behind == len(sample) else f"{100 * behind / len(sample):.0f} % of the"
    raise CloudError(
        f"{share} points lie behind the camera (z < 0); an optical frame has x right, y down, z "
        "forward. Turn y and z round: viewers save y up and z backwards. If z is up, it is a "
        "world frame."
    )


def _check_looks_down(sample: FloatArray, sensor: FloatArray, gravity: FloatArray) -> None:
    length = float(np.linalg.norm(gravity))
    view = np.median(sample, axis=0) - sensor
    distance = float(np.linalg.norm(view))
    if length < 1e-6 or distance < 1e-6 or view @ gravity >= -UPWARDS * length * distance:
        return
    given = _numbers(gravity)
    # In a camera's frame the camera is the origin.
    at_origin = float(np.linalg.norm(sensor)) < AT_ORIGIN
    camera_axes = at_origin and (sample[:, 2] > sensor[2]).mean() > 0.99
    if camera_axes and gravity[2] < -0.9 * length:
        raise GravityError(
            f"gravity {given} points from the scene to the sensor: the frame seems to be a "
            "camera's (x right, y down, z forward), not one with z up. Give gravity in this frame "
            "(0 0 1 for a camera that looks straight down), or the cloud in a frame with z up."
        )
    raise GravityError(
        f"with gravity {given} the sensor at {_numbers(sensor)} lies below what it sees; expected "
        "a place over the scene, and a vector that points down in the frame of the cloud. An "
        f"accelerometer at rest shows up, not down: use {_numbers(-gravity)}. If gravity is "
        "right, check where the sensor is said to be."
    )


def _numbers(vector: FloatArray) -> str:
    return " ".join(f"{value + 0.0:.4g}" for value in vector)

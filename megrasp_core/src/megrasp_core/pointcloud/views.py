"""The points of a fused cloud by the sensor that saw them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .depth_image import DepthImage

FloatArray = NDArray[np.float64]

MOST = 4
"""More sensors are taken for one in their middle: what ten cameras around a table see has hardly
a hidden side, and looking it up ten times is slow."""


@dataclass(frozen=True, eq=False)
class View:
    """points (K, 3) and where they were seen from (3,)."""

    points: FloatArray
    sensor: FloatArray

    @cached_property
    def image(self) -> DepthImage:
        """The points as the sensor saw them, by the settings that a depth image has of itself.

        Raises:
            CloudError, SensorPlaceError: see `DepthImage`.
        """
        return DepthImage(self.points, self.sensor)


def by_sensor(points: FloatArray, sensor: FloatArray) -> tuple[View, ...]:
    """Split points (K, 3) by their sensors (K, 3); one sensor (3,), or more than `MOST`, make one
    view.
    """
    if sensor.ndim == 1:
        return (View(points, sensor),)
    # Points of one view follow each other: few rows have to be sorted.
    changes = np.flatnonzero((np.diff(sensor, axis=0) != 0.0).any(axis=1)) + 1
    starts = np.concatenate([[0], changes]).astype(np.intp)
    places, which = np.unique(sensor[starts], axis=0, return_inverse=True)
    if len(places) > MOST:
        return (View(points, sensor.mean(axis=0)),)
    index = np.repeat(which.ravel(), np.diff([*starts, len(points)]))
    return tuple(View(points[index == i], place) for i, place in enumerate(places))

"""Depth image of a cloud as its sensor saw it: what lies in front of a seen surface and what
behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from megrasp_core.errors import CloudError, SensorPlaceError
from megrasp_core.ranges import COUNT, FROM_ONE, LENGTH, POSITIVE, check_ranges

__all__ = ["DepthImage", "DepthImageSettings"]

LEAST_IN_FRONT = 0.9
"""Share of the points that a sensor outside the cloud has in front of it, at least."""


@dataclass(frozen=True)
class DepthImageSettings:
    """How the depth image is drawn.

    Attributes:
        pitch_in_spacings: pixel pitch in units of the mean point spacing as seen from the sensor.
            Above 1, so that the raster of an organised cloud does not leave moire holes.
        max_side: longest side of the image (pixels).
        max_tangent: half opening of the image (tangent of the angle to its axis); points outside
            are unobserved.
        fill_passes: passes of the 3x3 filling of single empty pixels.
        fill_neighbours: an empty pixel is filled when at least so many of its 8 neighbours are
            seen.
        hole: distance (m) over which the rim of an unobserved patch is searched for the nearest
            surface.
        wide: a disc of this radius (m) without any reading in it is a wide hole: wider than
            shadows and single lost readings are.
        around: distance (m) over which a reading says how high what fills a wide hole may be.
    """

    pitch_in_spacings: float = 1.5
    max_side: int = 1024
    max_tangent: float = 1.5
    fill_passes: int = 2
    fill_neighbours: int = 3
    hole: float = 0.015
    wide: float = 0.012
    around: float = 0.04

    def __post_init__(self) -> None:
        check_ranges(
            self,
            pitch_in_spacings=POSITIVE,
            max_side=FROM_ONE,
            max_tangent=POSITIVE,
            fill_passes=COUNT,
            fill_neighbours=FROM_ONE,
            hole=LENGTH,
            wide=LENGTH,
            around=LENGTH,
        )


class DepthImage:
    """Smallest depth per pixel of a pinhole image that looks from the sensor to the middle of the
    cloud.

    Images of the same size, all depths along the optical axis (m, float32):

    - `seen`: the depth, `inf` where nothing was seen. Single empty pixels between seen ones are
      filled with the *nearest* of their 3x3 neighbours, so that sparse pixels do not read as free
      space through a surface.
    - `front`: where nothing was seen, the smallest depth on the rim of the unobserved patch
      (within `hole`), or the depth of the nearest seen pixel for larger patches. In front of it is
      free (the rim's surface, or something behind it, stops the ray), behind it unknown. Equals
      `seen` elsewhere.
    - `lid`: in wide holes, where a body may be that returned nothing, a shiny or a black one, the
      smallest depth on the rim of the whole patch, if it has one all around, and of the readings
      near by; `inf` elsewhere.
    """

    def __init__(
        self,
        points: np.ndarray,
        sensor: np.ndarray,
        settings: DepthImageSettings | None = None,
    ) -> None:
        """Draw the image.

        Args:
            points: (K, 3) full crop of the cloud, any frame.
            sensor: (3,) where the sensor was, same frame.
            settings: see `DepthImageSettings`.

        Raises:
            CloudError: no point is given.
            SensorPlaceError: the sensor is not outside the cloud.
        """
        self.settings = settings or DepthImageSettings()
        points = np.asarray(points)
        if len(points) == 0:
            raise CloudError(
                "the depth image was given a cloud of 0 points; expected at least 1. Check the "
                "crop."
            )
        self.sensor = np.asarray(sensor, dtype=np.float64).reshape(3)
        stride = max(1, len(points) // 4096)
        middle = points[::stride].mean(axis=0, dtype=np.float64)
        self.rotation = _looking_at(middle - self.sensor)  # rows: image x, image y, optical axis
        x, y, depth = self._camera_points(points)
        front = depth > 1e-3
        if front.mean() < LEAST_IN_FRONT:
            raise SensorPlaceError(
                f"the sensor position {np.round(self.sensor, 3).tolist()} has {int(front.sum())} "
                f"of {len(points)} points in front of it; expected a position outside the cloud, "
                "in the cloud's frame. Give the position of the camera in the frame of the cloud."
            )
        depth = np.where(front, depth, np.float32(1e-3))
        u, v = x / depth, y / depth
        limit = self.settings.max_tangent
        inside = front & (np.abs(u) < limit) & (np.abs(v) < limit)
        if not inside.all():
            u, v, depth = u[inside], v[inside], depth[inside]
        self.origin, self.pitch, self.shape = _raster(u, v, self.settings)
        self.pixel_size = float(self.pitch * np.median(depth[::stride]))
        self.seen = self._fill(self._splat(u, v, depth))
        self.front = self._close(self.seen)
        self.lid = self._lids(self.seen)

    def lookup(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth of points and of the surface at their pixels.

        Args:
            points: (P, 3) in the frame of the cloud.

        Returns:
            depth (P,), seen (P,), front (P,), float32 along the optical axis. Outside
            the image `seen` is inf and `front` the value of the nearest border pixel.
        """
        row, column, depth = self._pixels(points)
        height, width = self.shape
        outside = (column < 0) | (row < 0) | (column >= width) | (row >= height)
        np.clip(column, 0, width - 1, out=column)
        np.clip(row, 0, height - 1, out=row)
        index = row.astype(np.int32) * np.int32(width) + column.astype(np.int32)
        seen = self.seen.ravel()[index]
        seen[outside] = np.inf
        return depth, seen, self.front.ravel()[index]

    def below_lid(self, points: np.ndarray) -> np.ndarray:
        """How deep (P,) points (P, 3) lie behind the lid of a wide hole (m); -inf beside them."""
        row, column, depth = self._pixels(points)
        height, width = self.shape
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        below = np.full(len(depth), -np.inf, dtype=np.float32)
        at = row[inside].astype(np.int32), column[inside].astype(np.int32)
        below[inside] = depth[inside] - self.lid[at]
        return below

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Row and column (P, 2) of points (P, 3); those outside the image have some beyond its
        shape.
        """
        row, column, _ = self._pixels(points)
        limit = 1e6  # whole numbers, also for points beside the sensor
        both = np.stack([row, column], axis=1)
        return np.floor(np.clip(both, -limit, limit)).astype(np.intp)

    def _pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y, depth = self._camera_points(points)
        scale = np.float32(1.0 / self.pitch) / np.maximum(depth, np.float32(1e-3))
        column = x * scale - np.float32(self.origin[0] / self.pitch)
        row = y * scale - np.float32(self.origin[1] / self.pitch)
        return row, column, depth

    def _camera_points(self, points: np.ndarray) -> np.ndarray:
        """(3, P) float32: along image x, image y and the optical axis."""
        # The difference is taken in the precision that is given: float64 far from the origin.
        points = np.asarray(points)
        offset = points - self.sensor.astype(points.dtype)
        return self.rotation.astype(np.float32) @ offset.astype(np.float32, copy=False).T

    def _splat(self, u: np.ndarray, v: np.ndarray, depth: np.ndarray) -> np.ndarray:
        height, width = self.shape
        scale = np.float32(1.0 / self.pitch)
        column = np.clip(((u - self.origin[0]) * scale).astype(np.int32), 0, width - 1)
        row = np.clip(((v - self.origin[1]) * scale).astype(np.int32), 0, height - 1)
        image = np.full(height * width, np.inf, dtype=np.float32)
        np.minimum.at(image, row * width + column, depth)
        return image.reshape(self.shape)

    def _fill(self, image: np.ndarray) -> np.ndarray:
        for _ in range(self.settings.fill_passes):
            empty = ~np.isfinite(image)
            count = (
                ndimage.uniform_filter((~empty).astype(np.float32), size=3, mode="constant") * 9.0
            )
            fill = empty & (count > self.settings.fill_neighbours - 0.5)
            if not fill.any():
                break
            nearest = ndimage.minimum_filter(image, size=3, mode="constant", cval=np.inf)
            image = np.where(fill, nearest, image)
        return image

    def _close(self, image: np.ndarray) -> np.ndarray:
        empty = ~np.isfinite(image)
        if not empty.any():
            return image
        size = 2 * max(1, round(self.settings.hole / self.pixel_size)) + 1
        rim = ndimage.minimum_filter(image, size=size, mode="nearest")
        index = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
        rows, columns = np.asarray(index)
        nearest = image[rows, columns]
        return np.where(empty, np.minimum(rim, nearest), image).astype(np.float32)

    def _lids(self, image: np.ndarray) -> np.ndarray:
        lid = np.full(image.shape, np.inf, dtype=np.float32)
        empty = ~np.isfinite(image)
        distance = np.asarray(ndimage.distance_transform_edt(empty))
        wide = distance * self.pixel_size > self.settings.wide
        if not wide.any():
            return lid
        # Up to its rim: all that a disc of that radius covers which has no reading in it.
        middle = np.asarray(ndimage.distance_transform_edt(~wide))
        wide = empty & (middle * self.pixel_size < self.settings.wide)
        size = 2 * max(1, round(self.settings.around / self.pixel_size)) + 1
        near = ndimage.minimum_filter(image, size=size, mode="nearest")
        patches = np.zeros(image.shape, dtype=np.int32)
        ndimage.label(empty, output=patches)
        rim = ndimage.minimum_filter(image, size=3, mode="nearest")
        numbers = np.arange(patches.max() + 1)
        least = np.asarray(ndimage.minimum(rim, patches, numbers), dtype=np.float32)
        # What reaches the border may be no hole but where the cloud ends.
        least[np.unique(np.concatenate([*patches[[0, -1]], *patches[:, [0, -1]].T]))] = np.inf
        lid[wide] = np.minimum(near, least[patches])[wide]
        return lid


def _looking_at(direction: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        raise SensorPlaceError(
            "the sensor position is the middle of the cloud; expected a position outside it. Give "
            "the position of the camera in the frame of the cloud."
        )
    axis = direction / length
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis])


def _raster(
    u: np.ndarray, v: np.ndarray, settings: DepthImageSettings
) -> tuple[np.ndarray, float, tuple[int, int]]:
    """Origin (2,), pitch and (rows, columns) of an image whose pitch fits the density of the
    points.
    """
    low = np.array([u.min(), v.min()])
    extent = np.maximum(np.array([u.max(), v.max()]) - low, 1e-4)
    # The occupied area is counted on a coarse raster: a crop is not a rectangle in the image.
    cells = 48
    pitch = float(extent.max()) / cells
    stride = max(1, len(u) // 20_000)
    column = ((u[::stride] - low[0]) / pitch).astype(np.int32)
    row = ((v[::stride] - low[1]) / pitch).astype(np.int32)
    occupied = np.count_nonzero(np.bincount(row * (cells + 2) + column))
    spacing = np.sqrt(occupied * pitch * pitch / len(u))
    smallest = float(extent.max()) / (settings.max_side - 2)
    pitch = float(max(spacing * settings.pitch_in_spacings, smallest))
    size = np.ceil(extent / pitch).astype(int) + 2
    origin = (low - 0.5 * (size * pitch - extent)).astype(np.float32)
    return origin, pitch, (int(size[1]), int(size[0]))

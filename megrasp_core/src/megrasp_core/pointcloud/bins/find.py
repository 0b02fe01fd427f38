"""Finds a rectangular bin in a cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import CloudError, InvalidRequestError, NoBinError
from megrasp_core.pointcloud.cloud import Cloud
from megrasp_core.pointcloud.gravity import unit_gravity

from .choice import best_rim, is_bin
from .description import described
from .found import FoundBin
from .height_map import HeightMap, height_map
from .picture import Picture
from .rim import fitted
from .settings import BinSettings

FloatArray = NDArray[np.float64]

LARGEST_SIZE = 20.0
"""No bin for a robot has such edges (m)."""
ENOUGH = 75_000
"""So many points are enough for a first look."""


def find_bin(
    cloud: Cloud,
    gravity: ArrayLike,
    *,
    sensor: ArrayLike | None = None,
    size: ArrayLike | None = None,
    settings: BinSettings | None = None,
) -> FoundBin:
    """Find the bin in a cloud by its rim and walls.

    A bin is rectangular, open at the top, tilted by up to 10 degrees and turned in any way about
    gravity. It may be empty or overfull; of one of its walls nothing need be seen, nor of its
    floor. Where several bins are in the cloud it is the one of which most is seen, and among equal
    ones the one nearest to the middle of the cloud.

    The same arguments give the same result.

    Args:
        cloud: in metres; rows may be NaN.
        gravity: (3,) vector that points down in the frame of the cloud.
        sensor: (3,) where the cloud was seen from; the cloud's viewpoint by default. Without
            either, cells of which nothing was seen count neither as full nor as empty.
        size: (3,) inner edges at the rim, x and y in any order, and the depth (m); a zero stands
            for an edge that is not known. None: not known.
        settings: limits.

    Raises:
        NoBinError: no bin was found, or none of the given size; the message says what was looked
            for.
        CloudError: the cloud holds no finite point.
        GravityError: gravity is no direction.
        InvalidRequestError: the size is not three numbers of 0 or more.
    """
    settings = settings or BinSettings()
    level_from_cloud = _level(unit_gravity(gravity))
    edges_given = _size(size)
    finite = cloud.finite()
    if not len(finite):
        raise CloudError(
            f"none of the {len(cloud)} points is finite; expected a cloud. Check the depth image."
        )
    # Far origins cost digits.
    middle = np.median(finite.points[:: max(1, len(finite) // 1000)], axis=0)
    points = (finite.points - middle) @ level_from_cloud.T
    map = height_map(points, settings)
    if map is None:
        raise NoBinError(
            f"the cloud covers less than a bin: {len(finite)} points, {_extent(finite.points)}; "
            f"expected one with inner edges of {settings.shortest:g} m or more. "
            "Check the units and the field of view."
        )
    points = np.ascontiguousarray(points.T)
    step = max(1, points.shape[1] // ENOUGH)
    thin = np.ascontiguousarray(points[:, ::step])
    edges_wanted = edges_given[:2] if edges_given is not None and edges_given[:2].any() else None
    view = sensor if sensor is not None else finite.viewpoint
    eyes = None
    if view is not None:
        eyes = level_from_cloud @ (np.atleast_2d(np.asarray(view, np.float64)) - middle).T
    few_eyes = eyes[:, ::step] if eyes is not None and eyes.shape[1] > 1 else eyes
    rim = best_rim(thin, map, settings, edges_wanted, few_eyes)
    if rim is not None:
        rim = fitted(points, rim, map.noise, settings, edges_wanted, eyes, slacks=(0.006, 0.006))
    picture = Picture.of(thin, few_eyes)
    if rim is None or not is_bin(rim, map, settings, edges_wanted, picture):
        raise _none(thin, finite.points, map, settings, edges_wanted, few_eyes)
    place = eyes[:, 0] if eyes is not None and eyes.shape[1] == 1 else None
    found = described(thin, rim, place, edges_given, level_from_cloud, map.noise, settings)
    if found is None:
        raise _none(thin, finite.points, map, settings, edges_wanted, few_eyes)
    pose = np.eye(4)
    pose[:3, :3] = level_from_cloud.T
    pose[:3, 3] = middle
    return _in_cloud(found, pose)


def _level(gravity: FloatArray) -> FloatArray:
    """(3, 3) rotation level_from_cloud of unit gravity, z up, x near the cloud's x."""
    up = -gravity
    x = np.eye(3)[int(abs(up[0]) > 0.9)]
    x = x - up * (x @ up)
    x /= np.linalg.norm(x)
    return np.asarray(np.stack([x, np.cross(up, x), up]), np.float64)


def _size(size: ArrayLike | None) -> FloatArray | None:
    if size is None:
        return None
    edges_given = np.asarray(size, dtype=np.float64)
    if (
        edges_given.shape != (3,)
        or not np.isfinite(edges_given).all()
        or (edges_given < 0).any()
        or (edges_given[:2] > 0).sum() == 1
    ):
        raise InvalidRequestError(
            f"size {edges_given.tolist()} is not usable; expected three inner edges x, y, z in "
            "metres, the last the depth. Give 0 for a depth that is not known, or no size."
        )
    if edges_given.max() > LARGEST_SIZE:
        raise InvalidRequestError(
            f"size {edges_given.tolist()} was given; expected metres. It looks like millimetres: "
            "divide it by 1000."
        )
    return edges_given if edges_given.any() else None


def _in_cloud(found: FoundBin, cloud_from_level: FloatArray) -> FoundBin:
    return FoundBin(
        found.box.transformed(cloud_from_level),
        found.fill_level,
        found.cells,
        found.empty,
        found.walls_seen,
        found.seen,
        found.rim_error,
        found.depth_from,
    )


def _extent(points: FloatArray) -> str:
    low, high = np.percentile(points, [0.2, 99.8], axis=0)
    return " x ".join(f"{edge:.3g}" for edge in high - low) + " m"


def _none(
    points: FloatArray,
    cloud: FloatArray,
    map: HeightMap,
    settings: BinSettings,
    size: FloatArray | None,
    eyes: FloatArray | None,
) -> NoBinError:
    if size is not None:
        other = best_rim(points, map, settings, None, eyes)
        wanted = " x ".join(f"{edge:g}" for edge in size)
        if other is not None:
            x, y = sorted(2 * other.half, reverse=True)
            return NoBinError(
                f"no bin with inner edges of {wanted} m was found, but one of {x:.3f} x {y:.3f} "
                f"m; expected edges within {1000 * settings.size_tolerance:.0f} mm of the given "
                "ones. Measure the inside at the rim, or give no size."
            )
        what = f"with inner edges of {wanted} m"
    else:
        what = f"with inner edges of {settings.shortest:g} to {settings.longest:g} m"
    return NoBinError(
        f"no bin was found in a cloud of {_extent(cloud)}; expected a rectangular one {what}, "
        f"tilted by up to 10 degrees, with its rim or inside seen on three walls. Look at the "
        "cloud, check gravity, or give the region by hand."
    )

"""The support plane: the table or bin floor that the objects lie on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import InvalidRequestError

from .knn import local_normals, neighbours

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plane:
    """All x with normal . x = offset; the unit normal (3,) points to the objects."""

    normal: FloatArray
    offset: float

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Plane:
        """The plane nx x + ny y + nz z = d of four numbers; the normal may have any length.

        Raises:
            InvalidRequestError: they are not four finite numbers with a normal.
        """
        length = float(np.linalg.norm(numbers[:3])) if len(numbers) == 4 else 0.0
        if not np.isfinite(numbers).all() or length < 1e-6:
            raise InvalidRequestError(
                f"floor {' '.join(map(str, numbers))} was given; expected a height, or the four "
                "numbers nx ny nz d of a plane whose normal points up."
            )
        return cls(np.asarray(numbers[:3], dtype=np.float64) / length, numbers[3] / length)

    def height(self, points: FloatArray) -> FloatArray:
        """Return the signed distance (N,) in metres of points (N, 3), positive above."""
        return points @ self.normal - self.offset

    def moved(self, offset: ArrayLike) -> Plane:
        """Return the plane moved by `offset` (3,) metres."""
        return Plane(self.normal, self.offset + float(self.normal @ np.asarray(offset)))


@dataclass(frozen=True)
class PlaneSettings:
    """What counts as a support plane.

    band: half thickness in metres within which a point belongs to the plane. min_share: least
    share of the points that it must hold. max_below: largest share of points that may lie deeper
    than `below` metres under it; a box's top is level as well, but has a heap around and under it.
    max_tilt: largest angle (rad) between the plane's normal and up when gravity is known.
    levels: number of heights tried when gravity is known. hypotheses: number of points tried as
    seeds when it is not, each scored on `scored` points.
    """

    band: float = 0.004
    min_share: float = 0.04
    max_below: float = 0.05
    below: float = 0.012
    max_tilt: float = 0.12
    levels: int = 4
    hypotheses: int = 128
    scored: int = 4000


def support_plane(
    points: FloatArray,
    gravity: ArrayLike | None,
    *,
    normals: FloatArray | None = None,
    sensor: ArrayLike | None = None,
    settings: PlaneSettings | None = None,
) -> Plane | None:
    """Find the plane that carries the objects, or return None when the cloud shows none.

    points: (N, 3) evenly spaced (voxel means), finite. gravity: unit vector (3,) in the same frame
    or None. With gravity the level with most points that has almost nothing beneath it is taken
    and then fitted, so that a tilt of some degrees between gravity and the real table is absorbed.
    Without it RANSAC over points with their normals finds the largest plane that has almost
    everything on one side. normals: (N, 3) of any sign, estimated when missing. sensor: (3,),
    decides the side of the plane's normal when gravity is unknown and the points do not.
    """
    settings = settings or PlaneSettings()
    if len(points) < 30:
        return None
    if normals is None:
        normals = local_normals(points, neighbours(points, points, 16)[1])
    if gravity is None:
        seeds, up = _ransac(points, normals, sensor, settings), None
    else:
        up = -np.asarray(gravity, dtype=np.float64)
        up = up / np.linalg.norm(up)
        seeds = _levels(points, normals, up, settings)
    for seed in seeds:
        plane = _fit(points, normals, seed, up, settings)
        if plane is not None and _supports(plane, points, settings):
            return plane
    return None


def _levels(
    points: FloatArray, normals: FloatArray, up: FloatArray, settings: PlaneSettings
) -> Iterator[Plane]:
    """Yield level planes with most upward facing points and little beneath, each below the last.

    In a full bin the first is often the top of a large box, which then fails the fitted test.
    """
    flat = np.abs(normals @ up) > np.cos(0.35)
    heights = np.sort(points[flat] @ up)
    everything = np.sort(points @ up)
    # A strip of two bands on either side: of a tilted table it catches enough to fit.
    width = 4 * settings.band
    count = np.searchsorted(heights, heights + width, side="right") - np.arange(len(heights))
    beneath = np.searchsorted(everything, heights - settings.below)
    # Looser than the final test, because a tilt puts part of the table itself under the strip.
    count[beneath > 4 * settings.max_below * len(points)] = 0
    for _ in range(settings.levels):
        if not count.any():
            return
        best = int(np.argmax(count))
        yield Plane(up, float(np.median(heights[best : best + count[best]])))
        count[heights > heights[best] - width] = 0


def _ransac(
    points: FloatArray, normals: FloatArray, sensor: ArrayLike | None, settings: PlaneSettings
) -> list[Plane]:
    """Return the largest plane with almost all points on one side, or nothing."""
    rng = np.random.default_rng(0)
    seeds = rng.permutation(len(points))[: settings.hypotheses]
    scored = points[rng.permutation(len(points))[: settings.scored]]
    best: tuple[int, Plane] | None = None
    offsets = np.einsum("ij,ij->i", points[seeds], normals[seeds])
    heights = scored @ normals[seeds].T - offsets
    for column, (normal, offset) in enumerate(zip(normals[seeds], offsets, strict=True)):
        height = heights[:, column]
        # The estimated normal is off by some degrees: a generous band, narrowed by the fit.
        inside = int(np.count_nonzero(np.abs(height) < 2 * settings.band))
        if best is not None and inside <= best[0]:
            continue
        low = np.count_nonzero(height < -settings.below)
        high = np.count_nonzero(height > settings.below)
        if min(low, high) > 0.2 * len(scored):
            continue
        side = 1.0 if high >= low else -1.0
        if sensor is not None and max(low, high) < 0.02 * len(scored):
            side = 1.0 if float(np.asarray(sensor) @ normal - offset) >= 0 else -1.0
        best = (inside, Plane(normal * side, float(offset * side)))
    return [] if best is None else [best[1]]


def _fit(
    points: FloatArray,
    normals: FloatArray,
    seed: Plane,
    up: FloatArray | None,
    settings: PlaneSettings,
) -> Plane | None:
    """Fit the plane to its inliers by least squares, with a band that narrows."""
    plane = seed
    for factor in (3.0, 3.0, 2.0, 1.5, 1.0, 1.0):
        near = np.abs(plane.height(points)) < factor * settings.band
        near &= np.abs(normals @ plane.normal) > np.cos(0.5)
        if np.count_nonzero(near) < 10:
            return None
        members = points[near]
        centre = members.mean(axis=0)
        spread = (members - centre).T @ (members - centre)
        values, vectors = np.linalg.eigh(spread)
        if values[1] <= 0:
            return None
        normal = vectors[:, 0]
        normal = normal if normal @ plane.normal >= 0 else -normal
        if up is not None and normal @ up < np.cos(settings.max_tilt):
            return None
        plane = Plane(normal, float(normal @ centre))
    return plane


def _supports(plane: Plane, points: FloatArray, settings: PlaneSettings) -> bool:
    height = plane.height(points)
    on = np.count_nonzero(np.abs(height) <= settings.band)
    under = np.count_nonzero(height < -settings.below)
    return bool(
        on >= settings.min_share * len(points) and under <= settings.max_below * len(points)
    )

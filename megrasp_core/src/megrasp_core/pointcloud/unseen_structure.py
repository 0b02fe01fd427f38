"""Floor and walls that are there and were not seen: black bins, cropped tables, segmented objects.

The network and the check were made for scenes that stand on something. Where a cloud shows no
support, its place is taken from what the caller says, from the region, or from the lowest points,
and the support is put in as points where the camera looked past everything else. What lies behind
an object stays unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.errors import GravityError, InvalidRequestError

from .depth_image import DepthImage
from .floor_grid import footprint, grid_on, patch
from .plane import Plane
from .scene import SurfaceCloud
from .seen_support import TOLERANCE, shows_support
from .views import View

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STEP = (0.001, 0.004)
"""Least and largest distance (m) between the points that are put in."""
MOSTLY = 0.85
"""The floor was not seen when this share of the floor in view shows nothing."""
DOUBTFUL = 0.5
"""With this share it may not have been seen, or shiny or black objects hide it."""
ENOUGH = 0.15
"""Nor is that said of a heap's few gaps: so much of the whole floor has to show nothing."""
GAP = 0.001
"""Area (m2) of a patch without readings from which it is a look past the objects, not a dark or
shiny spot on one."""
NOTCH = 0.008
"""Half the width (m) of notches in what was seen that are taken for dark or steep sides of
objects, not for looks past them."""
RIM = 0.004
"""So wide (m) a rim of objects gives no readings: cameras lose the pixels at edges."""
LOWEST = 0.5
"""Percentile of the heights that an unknown floor is taken from."""
DEEPEST = (0.5, 1.5)
"""A floor may lie as far below the lowest points as the cloud is wide, within these limits (m)."""


@dataclass(frozen=True)
class UnseenStructure:
    """What was put in.

    Attributes:
        points: (R, 3) on floor and walls, in the frame of the cloud.
        seen_from: (R, 3) a sensor that looks at each of them.
        floor: the plane of the floor, None where there is nothing to say of it.
        estimated: the floor is where the lowest points are; it may be lower.
        note: what was done and how to do it better, "" where nothing was.
    """

    points: FloatArray
    seen_from: FloatArray
    floor: Plane | None
    note: str
    estimated: bool = False


def unseen_structure(
    surface: SurfaceCloud,
    *,
    floor: Plane | None = None,
    walls: bool = True,
    assume_empty: bool = False,
) -> UnseenStructure:
    """Find the floor, and the walls of a bin, that a cloud should show and does not.

    Args:
        surface: what was seen.
        floor: where it is known.
        walls: the region is the inside of a bin.
        assume_empty: all that shows no reading is floor or wall; otherwise only where most of
            the floor in view shows none, and patches without a reading that are smaller than a
            gap between objects stay unknown.

    Raises:
        InvalidRequestError: most of the cloud lies below `floor`, or all of it far above.
    """
    nothing = UnseenStructure(np.zeros((0, 3)), np.zeros((0, 3)), floor, "")
    if floor is not None:
        _check_floor(surface, floor)
    in_bin = walls and surface.region is not None
    source = "as given"
    if floor is None and in_bin:
        floor, source = _bottom(surface), "taken from the region"
    if floor is None and surface.gravity is not None and not shows_support(surface):
        floor, source = _lowest(surface), "taken from the lowest points"
    if floor is None:
        return nothing
    views = [_ViewOfNothing(surface, view) for view in surface.views]
    step = float(np.clip(min(view.image.pixel_size for view in views), *STEP))
    on_floor = grid_on(floor, footprint(surface, floor), step)
    inside = floor if in_bin else None
    empty = np.logical_or.reduce([view.empty(on_floor, inside) for view in views])
    seen = np.logical_or.reduce([view.seen(on_floor, inside) for view in views])
    empty &= ~seen
    share = empty.sum() / max(1, empty.sum() + seen.sum())
    much = empty.sum() > ENOUGH * len(empty)
    if not (assume_empty or (share > MOSTLY and much)):
        if share > DOUBTFUL and much:
            return replace(nothing, note=_doubt(share))
        return nothing
    points = np.concatenate([on_floor, _sides(surface, floor, step)]) if in_bin else on_floor
    looks = np.stack([view.empty(points, inside, all_gaps=assume_empty) for view in views])
    keep = looks.any(axis=0)
    for view in views:
        keep &= ~view.seen(points, inside)
    sensors = np.stack([view.sensor for view in views])
    note = f"the floor shows no reading in {100 * share:.0f} % of it; it is {source}"
    if in_bin:
        note += ", and the walls with it"
    elif source == "taken from the lowest points":
        note += (
            ", and grasps depend on it. Give the height of the floor, or the whole cloud and a "
            "region around the objects"
        )
    return UnseenStructure(
        points[keep],
        sensors[looks.argmax(axis=0)[keep]],
        floor,
        note + ".",
        estimated=source == "taken from the lowest points",
    )


def _doubt(share: float) -> str:
    return (
        f"the floor shows no reading in {100 * share:.0f} % of it, taken for objects that "
        "return nothing, shiny or black ones. Where it is the floor, set assume_empty."
    )


def level_floor(height: float, gravity: FloatArray | None) -> Plane:
    """The plane at a height (m) over the frame's origin, against gravity.

    Raises:
        GravityError: gravity is not known.
    """
    if gravity is None:
        raise GravityError(
            f"floor {height} was given and gravity is not; expected both, because a height is "
            "measured against gravity. Give gravity, or the floor as nx ny nz d."
        )
    return Plane(-np.asarray(gravity, dtype=np.float64), float(height))


def _check_floor(surface: SurfaceCloud, floor: Plane) -> None:
    height = floor.height(surface.points)
    below = int(np.count_nonzero(height < -0.02))
    if below > 0.2 * len(height):
        raise InvalidRequestError(
            f"the floor was given where {100 * below / len(height):.0f} % of the cloud lie more "
            f"than 20 mm below it (the lowest {-1000 * float(height.min()):.0f} mm); expected the "
            "surface that the objects lie on. Check floor, frame and gravity."
        )
    low, high = np.percentile(surface.points, (LOWEST, 100.0 - LOWEST), axis=0)
    gap, most = float(np.percentile(height, LOWEST)), np.clip((high - low).max(), *DEEPEST)
    if gap > most:
        raise InvalidRequestError(
            f"the floor was given {gap:.3g} m below the lowest points; expected the surface that "
            f"the objects lie on, in metres, at most {most:.3g} m below. Check floor, frame and "
            "gravity; a height in millimetres is divided by 1000."
        )


def _bottom(surface: SurfaceCloud) -> Plane:
    region = surface.region
    assert region is not None
    up = surface.sensor - region.centre if surface.gravity is None else -surface.gravity
    axis, sign = region.face_towards(up)
    normal = region.rotation[:, axis] * sign
    return Plane(normal, float(normal @ region.centre - region.size[axis] / 2))


def _lowest(surface: SurfaceCloud) -> Plane:
    assert surface.gravity is not None
    up = -surface.gravity
    return Plane(up, float(np.percentile(surface.points @ up, LOWEST)))


def _sides(surface: SurfaceCloud, floor: Plane, step: float) -> FloatArray:
    """Points (P, 3) on the four inner sides of the region, from its bottom to its top."""
    region = surface.region
    assert region is not None
    axis, sign = region.face_towards(floor.normal)
    up = region.rotation[:, axis] * region.size[axis] * sign
    edges = [region.rotation[:, (axis + k) % 3] * region.size[(axis + k) % 3] for k in (1, 2)]
    sides = []
    for along, across in (edges, edges[::-1]):
        for side in (-1.0, 1.0):
            corner = region.centre - up / 2 - along / 2 + side * across / 2
            sides.append(patch(corner, along, up, step))
    return np.concatenate(sides)


class _ViewOfNothing:
    """Where one sensor saw nothing."""

    def __init__(self, surface: SurfaceCloud, view: View) -> None:
        self.sensor, self.region = view.sensor, surface.region
        self.image = view.image
        self._pad = round((NOTCH + RIM) / self.image.pixel_size) + 2

    @cached_property
    def _open(self) -> BoolArray:
        return _open_patches(self.image, self._pad)

    def empty(
        self, points: FloatArray, bin_floor: Plane | None, *, all_gaps: bool = True
    ) -> BoolArray:
        """Whether the sensor looked at points (P, 3) and saw nothing there or before.

        Args:
            points: in the frame of the cloud.
            bin_floor: the region is a bin with this floor, into which it looks over the rim.
            all_gaps: also in small patches without readings.
        """
        if all_gaps:
            empty = ~np.isfinite(self.image.lookup(points)[1])
        else:
            row, column = np.moveaxis(self.image.pixels(points) + self._pad, 1, 0)
            height, width = self._open.shape
            inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
            empty = ~inside
            empty[inside] = self._open[row[inside], column[inside]]
        return empty & self._looks_at(points, bin_floor)

    def seen(self, points: FloatArray, bin_floor: Plane | None) -> BoolArray:
        """Whether the sensor saw points (P, 3) themselves, or something behind them."""
        depth, seen, _ = self.image.lookup(points)
        return np.isfinite(seen) & (seen >= depth - TOLERANCE) & self._looks_at(points, bin_floor)

    def _looks_at(self, points: FloatArray, bin_floor: Plane | None) -> BoolArray:
        """Whether no wall of the bin is between."""
        if bin_floor is None:
            return np.ones(len(points), dtype=bool)
        assert self.region is not None
        axis, sign = self.region.face_towards(bin_floor.normal)
        sensor = self.region.local(self.sensor[None])[0]
        inside = self.region.local(points)
        top = sign * self.region.size[axis] / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (top - inside[:, axis]) / (sensor[axis] - inside[:, axis])
            at_top = inside + share[:, None] * (sensor - inside)
            sides = [(axis + 1) % 3, (axis + 2) % 3]
            over_rim = (np.abs(at_top[:, sides]) <= self.region.size[sides] / 2 + 1e-9).all(axis=1)
            return over_rim & (share >= 0.0) & (share <= 1.0)


def _open_patches(image: DepthImage, pad: int) -> BoolArray:
    """Pixels without readings, with `pad` more on every side, that look past the objects: in
    patches that reach the border of the image or are larger than `GAP`, not in notches, and not
    on the rim of what was seen.
    """
    seen = np.pad(np.isfinite(image.seen), pad)
    near = _pixels_from(seen) <= NOTCH / image.pixel_size
    closed = seen | (_pixels_from(~near) > NOTCH / image.pixel_size)
    closed = _pixels_from(closed) <= RIM / image.pixel_size
    labels = np.zeros(closed.shape, dtype=np.int32)
    count = int(ndimage.label(~closed, output=labels))  # type: ignore[arg-type]
    area = np.bincount(labels.ravel(), minlength=count + 1) * image.pixel_size**2
    open_patch = area > GAP
    open_patch[labels[0, 0]] = True
    open_patch[0] = False
    return open_patch[labels]


def _pixels_from(mask: BoolArray) -> FloatArray:
    """Distance (H, W) of every pixel from the nearest one of a mask (H, W), in pixels."""
    return np.asarray(ndimage.distance_transform_edt(~mask), dtype=np.float64)

"""What the camera saw and did not see, as a test for arbitrary points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from megrasp_core.errors import InvalidRequestError
from megrasp_core.pointcloud import DepthImage, DepthImageSettings, View
from megrasp_core.ranges import LENGTH, check_ranges

from .cover import SurfaceCover
from .probe import one_per_cell

if TYPE_CHECKING:
    from megrasp_core.pointcloud import OrientedBox, Plane

__all__ = ["ObservationSettings", "PointState", "SceneObservation"]


class PointState(IntEnum):
    """What is known about a point."""

    FREE = 0
    NEAR = 1  # within the margin of a seen surface
    INSIDE = 2  # behind a seen surface by more than the margin, less than the shell: in that body;
    # or well within the outline of a seen surface below it; or in a wide hole of the depth image,
    # not over its rim: in a body that returned nothing
    UNSEEN = 3  # further behind a seen surface, or where nothing was seen
    WALL = 4  # in or beyond a wall of the bin, below its top
    FLOOR = 5  # below the bin's floor or the support plane


@dataclass(frozen=True)
class ObservationSettings:
    """How points are classified.

    Attributes:
        margin: half thickness of the band around the seen surface that counts as touching (m).
        shell: behind the seen surface, a point is taken to be inside the seen body down to this
            depth (m) and unknown beyond it. A gripper that enters a body from its seen side has to
            cross this shell.
        wall_margin: penetration into a wall of the bin that is tolerated (m).
        floor_margin: penetration into the floor that is tolerated (m); the verdict allows 1 mm.
        inset: also deeper than the shell a point below a seen surface is inside, if it is so far
            (m) within the outline of that surface, seen along gravity.
        lid_margin: so far below the rim of a wide hole (m) a point is inside.
        image: the depth image.
    """

    margin: float = 0.003
    shell: float = 0.015
    wall_margin: float = 0.001
    floor_margin: float = 0.001
    inset: float = 0.008
    lid_margin: float = 0.006
    image: DepthImageSettings = field(default_factory=DepthImageSettings)

    def __post_init__(self) -> None:
        check_ranges(
            self,
            margin=LENGTH,
            shell=LENGTH,
            wall_margin=LENGTH,
            floor_margin=LENGTH,
            inset=LENGTH,
            lid_margin=LENGTH,
        )


class SceneObservation:
    """Free, occupied and unknown space of one cloud.

    The depth image is drawn from the full crop (before voxels and thinning). In front of the seen
    surface is free, within the margin of it occupied (`NEAR`), behind it unknown; the first
    `shell` behind it counts as inside the seen body (`INSIDE`), and so does all below it that is
    not near its outline (`SurfaceCover`), where gravity or a region says where below is. A pixel
    where nothing was seen is free only in front of the nearest surface on its rim. Over the bottom
    of the region, what no sensor has readings of over centimetres is taken for a body as high as
    the rim of that hole (`DepthImage.lid`): shiny and black surfaces return nothing. With walls,
    the four sides of the region are walls below the region's top and its bottom is the floor;
    outside the region above the walls' top, where the crop holds no points, is free.
    """

    def __init__(
        self,
        points: np.ndarray,
        sensor: np.ndarray,
        *,
        gravity: np.ndarray | None = None,
        region: OrientedBox | None = None,
        walls: bool = True,
        floor: Plane | None = None,
        surface_points: np.ndarray | None = None,
        views: Sequence[View] = (),
        settings: ObservationSettings | None = None,
    ) -> None:
        """Draw the depth images and orient the region.

        Args:
            points: (K, 3) full crop, scene frame.
            sensor: (3,) position of the sensor, scene frame.
            gravity: (3,) unit vector, or None where unknown. Tells which side of the region is its
                bottom.
            region: box that was cropped to, or None.
            walls: the region is the inside of a bin.
            floor: support plane (normal away from the support) for scenes without walls.
            surface_points: (M, 3) evenly thinned surface for distances; default: the crop
                thinned to 3 mm.
            views: the same points by the sensor that saw them; what one sensor sees past, or in
                front of, is free whatever the others say. Default: one sensor saw all.
            settings: see `ObservationSettings`.

        Raises:
            CloudError, InvalidRequestError: see `DepthImage`.
        """
        self.settings = settings or ObservationSettings()
        self.points = np.asarray(points)
        self.sensor = np.asarray(sensor, dtype=np.float64).reshape(3)
        self.images = [
            view.image
            if self.settings.image == DepthImageSettings()
            else DepthImage(view.points, view.sensor, self.settings.image)
            for view in views or (View(self.points, self.sensor),)
        ]
        if surface_points is None:
            surface_points = one_per_cell(self.points, 0.003)
        # Columns lie together in memory: they are filtered axis by axis.
        self.surface_points = np.asfortranarray(surface_points, dtype=np.float32)
        self.gravity = None if gravity is None else np.asarray(gravity, dtype=np.float64)
        self.region = region
        self.walls = bool(walls and region is not None)
        self.floor = None if self.walls else floor
        self._box_from_world: np.ndarray | None = None
        self._half = np.zeros(3, dtype=np.float32)
        self._centre = np.zeros(3) if region is None else np.asarray(region.centre)
        if region is not None:
            self._box_from_world, self._half = self._upright(region)

    def _upright(self, region: OrientedBox) -> tuple[np.ndarray, np.ndarray]:
        """Transform into box axes with the third one up, and half sizes in that order."""
        up = -self.gravity if self.gravity is not None else self.sensor - region.centre
        box = region.upright(up)
        half = box.size.astype(np.float32) / 2
        if not (half > 0).all():
            raise InvalidRequestError(
                f"the region has size {box.size.tolist()}; expected three positive edges (m)."
            )
        box_from_world = np.eye(4)
        box_from_world[:3, :3] = box.rotation.T
        box_from_world[:3, 3] = -box.rotation.T @ box.centre
        return box_from_world, half

    def box_coordinates(self, points: np.ndarray) -> np.ndarray:
        """Points (P, 3) in the region's axes, third axis up, origin at its centre (float32).

        Raises:
            InvalidRequestError: the observation has no region.
        """
        if self._box_from_world is None:
            raise InvalidRequestError(
                "the observation has no region; give one to use its coordinates."
            )
        rotation = self._box_from_world[:3, :3].astype(np.float32)
        points = np.asarray(points)
        offset = points - self._centre.astype(points.dtype)
        return (rotation @ offset.astype(np.float32, copy=False).T).T

    @property
    def half(self) -> np.ndarray:
        """Half edges (3,) of the region in the order of `box_coordinates`; zeros without one."""
        return self._half

    def contains(self, points: np.ndarray, above: float = np.inf) -> np.ndarray:
        """Whether points (P, 3) lie within the region's sides, over its bottom and less than
        `above` over its top.

        All true without a region.
        """
        if self._box_from_world is None:
            return np.ones(len(points), dtype=bool)
        p, half = self.box_coordinates(points), self._half
        sides = (np.abs(p[:, :2]) <= half[:2]).all(axis=1)
        return sides & (p[:, 2] >= -half[2]) & (p[:, 2] <= half[2] + above)

    def signed_depth(self, points: np.ndarray) -> np.ndarray:
        """Depth (P,) of points (P, 3) behind the seen surface along the optical axis (m); negative
        in front.

        +inf where nothing was seen and the point is not in front of the rim of that patch. Of
        several sensors the one that knows best decides: the least depth.
        """
        return np.minimum.reduce([self._signed_depth(image, points) for image in self.images])

    def _signed_depth(self, image: DepthImage, points: np.ndarray) -> np.ndarray:
        depth, seen, front = image.lookup(points)
        signed = depth - front
        signed[~np.isfinite(seen) & (signed >= -self.settings.margin)] = np.inf
        return signed

    def classify(self, points: np.ndarray) -> np.ndarray:
        """State (P,) int8 of every point (P, 3); see `PointState`. Walls and floor go before what
        was seen.
        """
        s = self.settings
        signed = self.signed_depth(points)
        state = np.full(len(signed), PointState.UNSEEN, dtype=np.int8)
        state[signed <= s.shell] = PointState.INSIDE
        state[signed <= s.margin] = PointState.NEAR
        state[signed < -s.margin] = PointState.FREE
        unseen = np.flatnonzero(state == PointState.UNSEEN)
        if len(unseen) and self._cover is not None:
            covered = self._cover.depth(np.asarray(points)[unseen]) > s.margin
            state[unseen[covered]] = PointState.INSIDE
        if self._box_from_world is not None:
            state[self._in_wide_hole(points)] = PointState.INSIDE
        if self.walls:
            self._classify_walls(points, signed, state)
        elif self.floor is not None:
            state[self.floor.height(points) < -s.floor_margin] = PointState.FLOOR
        return state

    @cached_property
    def _cover(self) -> SurfaceCover | None:
        if self.gravity is not None:
            down = self.gravity
        elif self._box_from_world is not None:
            down = -self._box_from_world[2, :3]
        else:
            return None
        spacing = self.images[0].pixel_size
        return SurfaceCover(self.points, down, self.settings.inset, spacing)

    def _in_wide_hole(self, points: np.ndarray) -> np.ndarray:
        """Whether points (P, 3) lie within the region's sides and, for all sensors, below the lid
        of a wide hole.
        """
        margin = self.settings.lid_margin
        below = np.minimum.reduce([image.below_lid(points) for image in self.images]) > margin
        sides = np.abs(self.box_coordinates(points)[:, :2]) < self._half[:2]
        return below & sides.all(axis=1)

    def _classify_walls(self, points: np.ndarray, signed: np.ndarray, state: np.ndarray) -> None:
        s, half = self.settings, self._half
        p = self.box_coordinates(points)
        beyond = np.maximum(np.abs(p[:, 0]) - half[0], np.abs(p[:, 1]) - half[1])
        below_top = half[2] - p[:, 2]
        # The crop ends at the walls, so an unobserved pixel beside the bin says nothing about
        # space over it.
        state[(beyond > 0) & (below_top <= 0) & ~np.isfinite(signed)] = PointState.FREE
        state[np.minimum(beyond, below_top) > s.wall_margin] = PointState.WALL
        state[-half[2] - p[:, 2] > s.floor_margin] = PointState.FLOOR

    def floor_height(self, points: np.ndarray) -> np.ndarray:
        """Height (P,) of points (P, 3) over the bin's floor or the support plane (m), negative
        below; inf without either.
        """
        if self.walls:
            return self.box_coordinates(points)[:, 2] + self._half[2]
        if self.floor is not None:
            return self.floor.height(points)
        return np.full(len(points), np.inf)

    def structure_distance(self, points: np.ndarray) -> np.ndarray:
        """Distance (P,) of points (P, 3) to the nearest wall or floor (m), at least 0; inf without
        either.
        """
        if self.walls:
            p, half = self.box_coordinates(points), self._half
            beyond = np.maximum(np.abs(p[:, 0]) - half[0], np.abs(p[:, 1]) - half[1])
            below_top = half[2] - p[:, 2]
            sides = np.where(beyond < 0, np.hypot(beyond, np.minimum(below_top, 0.0)), -below_top)
            return np.maximum(np.minimum(sides, p[:, 2] + half[2]), 0.0)
        if self.floor is not None:
            return np.maximum(self.floor.height(points), 0.0)
        return np.full(len(points), np.inf)

"""From the camera's cloud to the scene encoder's input, in training and use.

Every step turns and moves with the cloud, the sensor, gravity and the region, up to rounding, but
one: the grid of the voxel means belongs to the frame. The claim of exact equivariance therefore
starts at the `SurfaceCloud`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import CloudError, EmptyRegionError
from megrasp_core.meshes import farthest_points
from megrasp_core.ranges import FROM_ONE, LENGTH, SHARE, Range, check_ranges

from .box import OrientedBox
from .cloud import Cloud
from .gravity import unit_gravity
from .knn import local_normals, neighbours, oriented, outlier_mask
from .plane import PlaneSettings, support_plane
from .sensor import sensor_place
from .views import View, by_sensor
from .voxels import VoxelGroups

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


FAR_UP = 10.0
"""Points so far over the region (m) are still between it and the sensor."""


@dataclass(frozen=True)
class SceneSettings:
    """How a cloud becomes nodes; a model must be run with the settings of its training.

    voxel: edge of the grid of means (m). max_nodes: most nodes of the scene encoder's finest
    level. region_margin: how far the region grows sideways and downwards, region_headroom: upwards
    (m). plane_keep: density of nodes on the support plane relative to elsewhere. plane_share:
    largest share of max_nodes for the plane, so that a wide table leaves the objects their nodes.
    plane_band: distance (m) within which a point belongs to the plane. normal_neighbours: points
    in a normal's patch. outlier_ratio: a voxel mean goes when its distance to its neighbours
    exceeds this many times the median; 0 keeps all.
    """

    voxel: float = 0.004
    max_nodes: int = 2048
    region_margin: float = 0.015
    region_headroom: float = 0.10
    plane_keep: float = 0.25
    plane_share: float = 0.3
    plane_band: float = 0.004
    normal_neighbours: int = 16
    outlier_ratio: float = 3.0

    def __post_init__(self) -> None:
        """Refuse values that no cloud can satisfy."""
        check_ranges(
            self,
            voxel=Range(0.0005, 0.05, unit="m"),
            max_nodes=FROM_ONE,
            region_margin=LENGTH,
            region_headroom=LENGTH,
            plane_keep=SHARE,
            plane_share=SHARE,
            plane_band=LENGTH,
            normal_neighbours=Range(3, whole=True),
            outlier_ratio=LENGTH,
        )


@dataclass(frozen=True, eq=False)
class SurfaceCloud:
    """The cleaned surface of the scene, in the cloud's frame (M voxel means of K measured points).

    points (M, 3); normals (M, 3) unit, turned to the sensor; on_plane (M,) true on the support
    plane; sensor (3,), the middle of several; gravity (3,) unit or None; crop (K, 3) every finite
    point in the grown region, for the check of what was seen; region as given or None. views:
    the points in the region and over it by the sensor that saw them. labels: (K,) of the crop, see
    `Cloud`, or None.
    """

    points: FloatArray
    normals: FloatArray
    on_plane: BoolArray
    sensor: FloatArray
    gravity: FloatArray | None
    crop: FloatArray
    region: OrientedBox | None
    views: tuple[View, ...] = ()
    labels: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class SceneNodes:
    """Input of the scene encoder: N nodes in the cloud's axes with the centroid at the origin.

    points (N, 3) and normals (N, 3) float32; on_plane (N,); gravity (3,) float32, zeros when
    unknown; centroid (3,) float64: world = points + centroid. The nodes are in the order of
    farthest points, so the first k are an even subset for every k. surface: all voxel means that
    the nodes were chosen from, for networks that look at fine geometry; None: not kept.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    on_plane: BoolArray
    gravity: NDArray[np.float32]
    centroid: FloatArray
    surface: SurfacePoints | None = None


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """M voxel means beside the nodes, in the nodes' coordinates.

    points (M, 3) and normals (M, 3) float32; on_plane (M,).
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    on_plane: BoolArray


def surface_cloud(
    cloud: Cloud,
    *,
    sensor: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    region: OrientedBox | None = None,
    settings: SceneSettings | None = None,
    threads: int = 1,
) -> SurfaceCloud:
    """Crop, average into voxels, drop outliers, estimate normals, find the support plane.

    sensor: (3,) or (N, 3) where each of the cloud's points was seen from; by default the cloud's
    viewpoint. gravity: vector (3,) that points down, in the cloud's frame, or None when unknown.
    region: only points in this box count, grown by the settings' margin to the sides and down, and
    by their headroom up; without a region all. threads: that search for neighbours.

    Raises EmptyRegionError when no point is left in the region, CloudError when the cloud holds no
    finite point or nobody says where the sensor was.
    """
    settings = settings or SceneSettings()
    origin = _sensor(cloud, sensor)
    down = None if gravity is None else unit_gravity(gravity)
    if region is not None:
        middle = np.atleast_2d(origin).mean(axis=0)
        inside = grown_region(region, down, middle, settings).contains(cloud.points)
        if not inside.any():
            raise _nothing_in_region(cloud, region)
        # What stands higher than the crop still hides what is behind it.
        column = replace(settings, region_headroom=settings.region_headroom + FAR_UP)
        in_view = grown_region(region, down, middle, column).contains(cloud.points)
    else:
        inside = np.isfinite(cloud.points).all(axis=1)
        if not inside.any():
            raise CloudError(
                f"none of the {len(cloud)} points is finite; expected a cloud in metres. Check "
                "the depth image."
            )
        in_view = inside
    crop = cloud.points[inside]
    groups = VoxelGroups(crop, settings.voxel)
    points = groups.mean(crop)
    seen_from = groups.mean(origin[inside]) if origin.ndim == 2 else origin
    normals, keep = _normals(points, seen_from, settings, threads)
    points, normals = points[keep], normals[keep]
    plane = support_plane(
        points,
        down,
        normals=normals,
        sensor=np.atleast_2d(origin).mean(axis=0),
        settings=PlaneSettings(band=settings.plane_band),
    )
    on_plane = np.zeros(len(points), bool)
    if plane is not None:
        on_plane = np.abs(plane.height(points)) <= settings.plane_band
    seen_crop_from = origin[inside] if origin.ndim == 2 else origin
    return SurfaceCloud(
        points,
        normals,
        on_plane,
        np.atleast_2d(seen_crop_from).mean(axis=0),
        down,
        crop,
        region,
        by_sensor(cloud.points[in_view], origin[in_view] if origin.ndim == 2 else origin),
        None if cloud.labels is None else cloud.labels[inside],
    )


def scene_nodes(
    surface: SurfaceCloud, settings: SceneSettings | None = None, seed: int = 0
) -> SceneNodes:
    """Choose the nodes: thinner on the support plane, even everywhere, centred.

    The density of nodes on the plane is `plane_keep` times that elsewhere, or less where its share
    would exceed `plane_share`; which ones stay is decided by farthest point sampling within the
    plane and within the rest, so the choice does not depend on the frame. seed 0 starts from the
    point farthest from the centroid; another one from a point drawn with it, which varies the
    nodes in training.

    Raises EmptyRegionError when the surface holds no points.
    """
    if not len(surface.points):
        raise EmptyRegionError(
            "the surface holds no points; expected at least one. Check region and cloud."
        )
    counts = node_counts(surface.on_plane, settings or SceneSettings())
    return nodes_at(surface, choose_nodes(surface.points, surface.on_plane, counts, seed))


def node_counts(on_plane: BoolArray, settings: SceneSettings) -> tuple[int, int]:
    """How many nodes are chosen among the points off the plane and on it."""
    plane = int(np.count_nonzero(on_plane))
    rest = len(on_plane) - plane
    kept = rest + settings.plane_keep * plane
    scale = min(1.0, settings.max_nodes / kept) if kept else 0.0
    most = int(settings.plane_share * settings.max_nodes)
    for_plane = min(int(np.ceil(scale * settings.plane_keep * plane)), most)
    for_rest = min(rest, settings.max_nodes - for_plane)
    if not for_rest and not for_plane:
        # Only the plane is there and none of it is to be kept: an empty table still needs one
        # node.
        for_plane = 1
    return for_rest, for_plane


def choose_nodes(
    points: FloatArray, on_plane: BoolArray, counts: tuple[int, int], seed: int
) -> NDArray[np.intp]:
    """Return which of points (M, 3) are nodes: `counts` off the plane and on it, in the order of
    farthest points; the seed is that of `scene_nodes`.
    """
    rng = np.random.default_rng(seed) if seed else None
    chosen = np.concatenate(
        [
            part[_farthest(points[part], count, rng)]
            for part, count in zip((np.flatnonzero(~on_plane), np.flatnonzero(on_plane)), counts)
            if count
        ]
    )
    return chosen[_farthest(points[chosen], len(chosen), rng)]


def nodes_at(surface: SurfaceCloud, chosen: NDArray[np.intp]) -> SceneNodes:
    """The nodes at the chosen points of the surface, in their order."""
    points = surface.points[chosen]
    centroid = points.mean(axis=0)
    gravity = np.zeros(3) if surface.gravity is None else surface.gravity
    return SceneNodes(
        (points - centroid).astype(np.float32),
        surface.normals[chosen].astype(np.float32),
        surface.on_plane[chosen],
        gravity.astype(np.float32),
        centroid,
        SurfacePoints(
            (surface.points - centroid).astype(np.float32),
            surface.normals.astype(np.float32),
            surface.on_plane,
        ),
    )


def grown_region(
    region: OrientedBox, gravity: FloatArray | None, sensor: FloatArray, settings: SceneSettings
) -> OrientedBox:
    """Return the region with margin on all sides and headroom on its upper face.

    Up is against gravity, or towards the sensor when gravity is unknown; never "the box's z",
    which points down in a camera's optical frame.
    """
    up = -gravity if gravity is not None else sensor - region.centre
    headroom = max(0.0, settings.region_headroom - settings.region_margin)
    return region.grown(settings.region_margin).extended(up, headroom)


def _farthest(points: FloatArray, count: int, rng: np.random.Generator | None) -> NDArray[np.intp]:
    start = None if rng is None else int(rng.integers(len(points)))
    return farthest_points(points, count, start)


def _normals(
    points: FloatArray, seen_from: FloatArray, settings: SceneSettings, threads: int
) -> tuple[FloatArray, BoolArray]:
    """Return normals (M, 3) and the mask (M,) of points to keep, from one neighbour search."""
    distance, index = neighbours(points, points, settings.normal_neighbours, threads=threads)
    keep = np.ones(len(points), bool)
    if settings.outlier_ratio > 0:
        keep = outlier_mask(distance[:, : min(9, distance.shape[1])], settings.outlier_ratio)
    weights = None if keep.all() else keep.astype(np.float64)
    return oriented(local_normals(points, index, weights), points, seen_from), keep


def _sensor(cloud: Cloud, sensor: ArrayLike | None) -> FloatArray:
    origin = cloud.viewpoint if sensor is None else sensor
    if origin is None:
        raise CloudError(
            "nobody says where the sensor was: the cloud has no viewpoint and no sensor was "
            "given. Give the sensor's place (x, y, z) in the cloud's frame; in a camera's "
            "optical frame it is 0 0 0."
        )
    return sensor_place(origin, len(cloud))


def _nothing_in_region(cloud: Cloud, region: OrientedBox) -> EmptyRegionError:
    finite = cloud.finite().points
    if not len(finite):
        return EmptyRegionError(
            f"the region is empty: none of the {len(cloud)} points is finite. Check the depth "
            "image."
        )
    low, high = finite.min(axis=0).round(3).tolist(), finite.max(axis=0).round(3).tolist()
    return EmptyRegionError(
        f"none of the {len(finite)} points lies in the region with centre "
        f"{region.centre.round(3).tolist()} and size {region.size.round(3).tolist()}; the cloud "
        f"reaches from {low} to {high}. Give the region in the frame of the cloud, in metres."
    )

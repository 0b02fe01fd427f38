"""What gets between the fingers: is anything there, how wide is it, does it face the fingers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from megrasp_core.ranges import FROM_ONE, LENGTH, POSITIVE, SHARE, Range, check_ranges

from .boxes import inside_bounds, posed_box_bounds
from .probe import ClosingVolume

__all__ = ["ContactSettings", "ContactSurface", "Contacts", "contact_surface", "measure_contacts"]


@dataclass(frozen=True)
class ContactSettings:
    """How contacts are measured.

    Attributes:
        max_points: the crop is thinned to at most so many points for the measurement.
        min_points: fewer seen points between the fingers mean that the grasp is empty.
        tip_clear: points beyond the fingertips minus this length do not count as material (m): the
            tips only touch them.
        floor_band: points nearer than this to the floor or the support plane are no material (m).
        percentile: trimmed on either side of the extent along X (percent): noisy edge points.
        edge: the outermost part of the material along X whose normals are compared with X (m).
        full_engagement: reach of the fingers past the top of the material that counts as fully
            engaged (m).
        misaligned: alignment of a contact whose normals stand at a right angle to X or are not
            seen.
        least_tolerance: of the width, where its ends are sharp (m): pads give way, and clouds have
            noise.
    """

    max_points: int = 40000
    min_points: int = 6
    tip_clear: float = 0.003
    floor_band: float = 0.004
    percentile: float = 1.0
    edge: float = 0.006
    full_engagement: float = 0.015
    misaligned: float = 0.4
    least_tolerance: float = 0.003

    def __post_init__(self) -> None:
        check_ranges(
            self,
            max_points=FROM_ONE,
            min_points=FROM_ONE,
            tip_clear=LENGTH,
            floor_band=LENGTH,
            percentile=Range(0, below=50),
            edge=LENGTH,
            full_engagement=POSITIVE,
            misaligned=SHARE,
            least_tolerance=LENGTH,
        )


@dataclass(frozen=True)
class ContactSurface:
    """Seen points that can be material, float32: points (K, 3) for extents, and sparser ones with
    normals.
    """

    points: np.ndarray
    node_points: np.ndarray
    node_normals: np.ndarray


@dataclass(frozen=True)
class Contacts:
    """Per grasp, arrays of length N.

    Attributes:
        count: seen points between the fingers.
        width: extent of the material along X (m); NaN where empty.
        offset: middle of the material from the middle between the fingers along X (m); NaN where
            empty.
        engagement: length by which the open fingertips reach past the top of the material (m); 0
            where empty.
        alignment: 0..1, how well the seen sides of the material face the fingers.
        quality: 0..1, product of alignment, engagement and centring; 0 where empty.
        tolerance: the width is known to this (m); NaN where empty.
    """

    count: np.ndarray
    width: np.ndarray
    offset: np.ndarray
    engagement: np.ndarray
    alignment: np.ndarray
    quality: np.ndarray
    tolerance: np.ndarray

    def part(self, rows: np.ndarray) -> Contacts:
        """Those of some grasps (n,)."""
        return Contacts(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})

    def put(self, index: np.ndarray, other: Contacts) -> None:
        """Take other ones for the grasps `index` (n,)."""
        for item in fields(self):
            getattr(self, item.name)[index] = getattr(other, item.name)


def contact_surface(
    crop: np.ndarray,
    node_points: np.ndarray,
    node_normals: np.ndarray,
    floor_distance: np.ndarray | None = None,
    node_floor_distance: np.ndarray | None = None,
    settings: ContactSettings | None = None,
) -> ContactSurface:
    """Select the points that can be material.

    Args:
        crop: (K, 3) full crop.
        node_points: (M, 3) voxel means.
        node_normals: (M, 3) their normals.
        floor_distance: (K,) heights of the crop over the floor, None where it is not known.
        node_floor_distance: (M,) those of the voxel means.
        settings: see `ContactSettings`.
    """
    s = settings or ContactSettings()
    if floor_distance is not None:
        crop = crop[floor_distance > s.floor_band]
    if node_floor_distance is not None:
        keep = node_floor_distance > s.floor_band
        node_points, node_normals = node_points[keep], node_normals[keep]
    if len(crop) > s.max_points:
        # An even stride over a shuffled order: clouds come row by row, so a plain stride would
        # leave stripes.
        crop = crop[np.random.default_rng(0).permutation(len(crop))[: s.max_points]]
    # Columns lie together in memory: points are filtered axis by axis, once per grasp.
    return ContactSurface(
        np.asfortranarray(crop, dtype=np.float32),
        np.asfortranarray(node_points, dtype=np.float32),
        np.asarray(node_normals, dtype=np.float32),
    )


def measure_contacts(
    surface: ContactSurface,
    volume: ClosingVolume,
    world_from_gripper: np.ndarray,
    settings: ContactSettings | None = None,
) -> Contacts:
    """Measure what lies in the closing volume of every pose.

    Args:
        surface: seen material.
        volume: box between the open fingers, gripper frame.
        world_from_gripper: (N, 4, 4).
        settings: see `ContactSettings`.
    """
    s = settings or ContactSettings()
    n = len(world_from_gripper)
    out = {k: np.full(n, v, dtype=np.float32) for k, v in _EMPTY.items()}
    count = np.zeros(n, dtype=np.int32)
    high = volume.high.copy()
    high[2] -= s.tip_clear
    for i, pose in enumerate(np.asarray(world_from_gripper)):
        points = _inside(surface.points, pose, volume.low, high)[0]
        count[i] = len(points)
        if len(points) < s.min_points:
            continue
        left, right = np.percentile(points[:, 0], [s.percentile, 100 - s.percentile])
        top = np.percentile(points[:, 2], s.percentile)
        # The trimmed extent of evenly spread points is short by the trimmed share.
        width = (right - left) / (1 - 0.02 * s.percentile)
        nodes, index = _inside(surface.node_points, pose, volume.low, high)
        normals = surface.node_normals[index] @ pose[:3, :3].astype(np.float32)
        out["width"][i] = width
        core = np.percentile(points[:, 0], [5 * s.percentile, 100 - 5 * s.percentile])
        out["tolerance"][i] = s.least_tolerance + (right - left - (core[1] - core[0])) / 2
        out["offset"][i] = (left + right) / 2 - volume.centre
        out["engagement"][i] = max(volume.tip - top, 0.0)
        out["alignment"][i] = _alignment(nodes[:, 0], normals, left, right, s)
    out["quality"] = _quality(out, volume, s)
    return Contacts(count=count, **out)


_EMPTY = {
    "width": np.nan,
    "tolerance": np.nan,
    "offset": np.nan,
    "engagement": 0.0,
    "alignment": 0.0,
}


def _inside(
    points: np.ndarray, pose: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points within the box in the gripper frame, and their indices."""
    # In the scene's axes first: only a few percent of the points are near one gripper.
    index = np.flatnonzero(inside_bounds(points.T, *posed_box_bounds(pose, low, high)))
    from_origin = points.T[:, index] - pose[:3, 3, None].astype(np.float32)
    local = pose[:3, :3].T.astype(np.float32) @ from_origin
    ok = inside_bounds(local, low, high)
    return local[:, ok].T, index[ok]


def _alignment(
    x: np.ndarray, normals: np.ndarray, left: float, right: float, s: ContactSettings
) -> float:
    """Mean over both sides of |n . X| in the XY plane, weighted by how steep the seen surface
    is.
    """
    sides = []
    for edge, sign in ((x < left + s.edge, -1.0), (x > right - s.edge, 1.0)):
        planar = normals[edge, :2]
        steep = np.linalg.norm(planar, axis=1)
        total = float(steep.sum())
        facing = (
            float(np.clip(sign * planar[:, 0], 0.0, None).sum()) / total
            if total > 0.2
            else s.misaligned
        )
        sides.append(max(facing, s.misaligned))
    return min(sides)


def _quality(out: dict[str, np.ndarray], volume: ClosingVolume, s: ContactSettings) -> np.ndarray:
    half = (volume.high[0] - volume.low[0]) / 2
    engaged = np.clip(out["engagement"] / s.full_engagement, 0.0, 1.0)
    centred = 1.0 - np.clip(np.abs(np.nan_to_num(out["offset"], nan=half)) / half, 0.0, 1.0) ** 2
    quality = out["alignment"] * engaged * centred
    return np.where(np.isnan(out["width"]), 0.0, quality).astype(np.float32)

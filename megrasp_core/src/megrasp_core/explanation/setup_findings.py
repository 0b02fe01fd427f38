"""Region, floor and sensor held against the whole cloud: a synthesis sees only what is in the
region, and cannot tell that the region is in the wrong place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import MegraspError
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.pointcloud import (
    Cloud,
    OrientedBox,
    Plane,
    find_bin,
    support_plane,
    voxel_means,
)
from megrasp_core.ranking import SceneObservation
from megrasp_core.synthesizer import SynthesisRequest, sensor_doubt

__all__ = ["SetupFindings", "setup_findings"]

FloatArray = NDArray[np.float64]

SHIFT, EDGE, TURN = 0.008, 0.015, 3.0
"""From so much on the region is said not to be at the bin: middle, edges (m), yaw (degrees)."""
FLOOR = 0.008
"""From so much on floors are said to differ (m)."""
STRIP = 0.012
"""Inner strip along the walls that says nothing of the floor (m)."""
REACH = 0.25
"""The floor is looked for so far over and under where it was said to be (m)."""
VOXEL = 0.005
COVERED = 0.3
"""Share of the footprint that a floor over the given one must show: the tops of flat objects show
less."""


@dataclass(frozen=True)
class SetupFindings:
    """What does not fit.

    Attributes:
        told: sentences, the gravest first.
        found: the bin where it was found, if it was looked for; None otherwise.
    """

    told: tuple[str, ...]
    found: OrientedBox | None = None


def setup_findings(
    cloud: Cloud,
    request: SynthesisRequest,
    observation: SceneObservation | None = None,
    offset: FloatArray | None = None,
) -> SetupFindings:
    """Look for a region off the bin, a floor too high or too low, a sensor elsewhere.

    Args:
        cloud: all of it.
        request: with region, floor, gravity.
        observation: what the synthesis took as seen, where it came so far.
        offset: (3,) from these coordinates to those in which places are told (m); None: the same.
    """
    told = [] if observation is None else sensor_doubt(observation, offset)
    found = None
    if request.region is not None and request.walls and request.gravity is not None:
        found = _bin_at(cloud, request, request.region)
        if found is not None:
            up = -np.asarray(request.gravity)
            told += _differences(found, request.region, up, offset)
    # What was already said of the bottom need not be said twice.
    if not any("its floor" in text for text in told):
        told += _floor(cloud, request)
    return SetupFindings(tuple(told), found)


def _bin_at(cloud: Cloud, request: SynthesisRequest, region: OrientedBox) -> OrientedBox | None:
    """The inside of the bin at the region, with its axes along the region's; None without one."""
    assert request.gravity is not None
    try:
        found = find_bin(cloud, request.gravity, sensor=request.sensor)
    except MegraspError:
        return None
    up = -np.asarray(request.gravity)
    box, given = found.box.upright(up), region.upright(up)
    # The quarter turn at which the axes fit best, since a bin has no front.
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for _ in range(4):
        if box.rotation[:, 0] @ given.rotation[:, 0] > np.sqrt(0.5) - 1e-9:
            break
        pose = box.world_from_box.copy()
        pose[:3, :3] = pose[:3, :3] @ quarter
        box = OrientedBox(pose, box.size[[1, 0, 2]])
    away = np.abs(given.local(box.centre[None])[0])
    if (away[:2] > 0.75 * given.size[:2]).any():
        return None  # of several bins another one
    if found.depth_from in ("floor", "size"):
        return box
    # Its depth is a guess: the region's bottom serves as well.
    bottom = given.centre - given.rotation[:, 2] * given.size[2] / 2
    top = box.centre + box.rotation[:, 2] * box.size[2] / 2
    depth = max(float((top - bottom) @ box.rotation[:, 2]), 0.01)
    pose = box.world_from_box.copy()
    pose[:3, 3] = top - box.rotation[:, 2] * depth / 2
    return OrientedBox(pose, np.array([*box.size[:2], depth]))


def _differences(
    box: OrientedBox, region: OrientedBox, up: FloatArray, origin: FloatArray | None
) -> list[str]:
    given = region.upright(up)
    offset = given.rotation.T @ (box.centre - given.centre)
    told = []
    shifts = [
        f"{1000 * abs(by):.0f} mm to {'+' if by > 0 else '-'}{axis}"
        for by, axis in zip(offset[:2], "xy", strict=True)
        if abs(by) > SHIFT
    ]
    if shifts:
        told.append(f"lies {' and '.join(shifts)} of the region")
    if (np.abs(box.size - given.size)[:2] > EDGE).any():
        sizes = (" x ".join(f"{1000 * edge:.0f}" for edge in one.size[:2]) for one in (box, given))
        told.append("is {} mm inside, and the region {} mm".format(*sizes))
    yaw = np.degrees(np.arctan2(*(given.rotation.T @ box.rotation[:, 0])[[1, 0]]))
    if abs(yaw) > TURN:
        told.append(f"is turned by {yaw:.0f} degrees against the region")
    low = offset[2] - box.size[2] / 2 + given.size[2] / 2
    if abs(low) > FLOOR:
        where = "over" if low > 0 else "under"
        told.append(f"has its floor {1000 * abs(low):.0f} mm {where} the region's bottom")
    if not told:
        return []
    numbers = pose7_from_matrix(box.world_from_box)
    numbers[:3] += 0.0 if origin is None else origin
    pose = ", ".join(f"{round(value, 4) + 0.0:.10g}" for value in numbers)
    size = ", ".join(f"{edge:.3f}" for edge in box.size)
    return [
        f"the bin that the cloud shows {', '.join(told)}: the region does not fit it. Give "
        f"pose [{pose}] and size [{size}], or what megrasp bin find writes."
    ]


def _floor(cloud: Cloud, request: SynthesisRequest) -> list[str]:
    """The floor that the cloud shows against the one that was given: the plane of the request, or
    the bottom of a region with walls.
    """
    if request.gravity is None:
        return []
    up = -np.asarray(request.gravity)
    given, name = request.floor, "the given floor"
    if not isinstance(given, Plane):
        if request.region is None or not request.walls:
            return []
        box = request.region.upright(up)
        normal = box.rotation[:, 2]
        given, name = Plane(normal, float(normal @ box.centre) - box.size[2] / 2), (
            "the bottom of the region"
        )  # fmt: skip
    points = cloud.finite().points
    points = points[np.abs(given.height(points)) < REACH]
    if request.region is not None:
        box = request.region.upright(up)
        room = np.maximum(box.size[:2] / 2 - STRIP, 0.0)
        points = points[(np.abs(box.local(points)[:, :2]) <= room).all(axis=1)]
    voxels = voxel_means(points, VOXEL) if len(points) else points
    plane = support_plane(voxels, request.gravity)
    if plane is None:
        return []
    on_it = voxels[np.abs(plane.height(voxels)) < VOXEL]
    height = float(np.median(given.height(on_it)))
    if abs(height) <= FLOOR:
        return []
    if height > 0 and len(on_it) < COVERED * _cells(voxels, plane):
        return []
    change = "raise" if height > 0 else "lower"
    where = "over" if height > 0 else "under"
    mm = f"{1000 * abs(height):.0f} mm"
    return [f"the floor was seen {mm} {where} {name}: {change} it by that."]


def _cells(voxels: FloatArray, plane: Plane) -> int:
    """How many voxels the footprint of the points has, seen along the plane's normal."""
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    return len(np.unique(np.round(voxels @ axes.T / VOXEL).astype(np.int64), axis=0))

"""Frames, gravity, units, region and floor: the same functions that a request goes through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import EmptyRegionError, InvalidRequestError, MegraspError
from megrasp_core.pointcloud import (
    Cloud,
    Plane,
    SurfaceCloud,
    check_not_upside_down,
    check_view,
    level_floor,
    only_support_left,
    surface_cloud,
    unseen_structure,
)
from megrasp_ros.errors import in_ros_words
from megrasp_ros.server.frames import FrameSource, gravity_in
from megrasp_ros.server.parameters import Settings
from megrasp_ros.server.sensing import placed

from .asked import Asked
from .check import Check
from .input import Scene

FEW = 500
"""Fewer points than this in the region show no object well."""


def geometry(asked: Asked, settings: Settings, scene: Scene) -> list[Check]:
    """What a request would make of the scene."""
    source = scene.header.frame_id
    if not source:
        text = "the cloud's frame_id is empty; set the frame in the camera's driver"
        return [Check("frame", "fail", text)]
    frames = FrameSource(asked.node)
    try:
        frames.listen(settings)
        if settings.planning_frame and settings.extrinsics is None:
            # What tf2 has to say comes within a second or two.
            asked.pause(min(2.0, asked.seconds))
        frame, matrix = frames.planning_from_cloud(scene.header, settings)
    except MegraspError as error:
        return [Check("frame", "fail", str(error))]
    found = [Check("frame", "ok", frames.last)]
    try:
        gravity = gravity_in(frame, settings, optical=scene.optical and frame == source)
    except MegraspError as error:
        return [*found, Check("gravity", "fail", str(error))]
    given = "parameter" if settings.gravity is not None else "z is up"
    numbers = " ".join(f"{value:.3g}" for value in gravity)
    found.append(Check("gravity", "ok", f"{numbers} in {frame!r} ({given})"))
    try:
        seen = scene.decode()
    except MegraspError as error:
        return [*found, Check("view", "fail", in_ros_words(str(error)))]
    # A depth image brings its place itself.
    origin = settings.sensor_origin if seen.viewpoint is None else seen.viewpoint
    cloud = Cloud(seen.points, viewpoint=origin).transformed(matrix)
    surface = None
    try:
        if scene.optical:
            check_view(seen.points, optical=True)
        with placed("" if scene.optical else source, settings.sensor_origin.tolist()):
            surface = _surface(cloud, gravity, settings)
        found.append(Check("view", "ok", "units, axes, gravity and the sensor's place agree"))
    except MegraspError as error:
        found.append(Check("view", "fail", in_ros_words(str(error))))
    if surface is not None:
        found += _floor(surface, settings)
    return [*found, _region(settings, cloud.points)]


def _region(settings: Settings, points: NDArray[np.float64]) -> Check:
    if settings.region is None:
        return Check("region", "ok", "none: all of the cloud is looked at")
    inside = int(settings.region.contains(points).sum())
    low, high = np.percentile(points, (1, 99), axis=0)
    spans = ", ".join(
        f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    advice = (
        f"the cloud has {spans} m in the planning frame; set region.pose and region.size, or "
        "the size to 0 for all of it"
    )
    if inside == 0:
        return Check("region", "fail", f"no point lies in it; {advice}")
    if inside < FEW:
        return Check("region", "warn", f"only {inside} points lie in it; {advice}")
    doubt = settings.region.doubt(points)
    if doubt:
        return Check("region", "warn", doubt)
    return Check("region", "ok", f"{inside} points in it")


def _surface(
    cloud: Cloud, gravity: NDArray[np.float64], settings: Settings
) -> SurfaceCloud | None:
    """What the check sees of a cloud, None where nothing lies in the region.

    Raises:
        MegraspError: units, axes, gravity or the sensor's place are wrong.
    """
    region = settings.region
    check_view(cloud.points, sensor=cloud.viewpoint, gravity=gravity, region=region)
    try:
        surface = surface_cloud(cloud, gravity=gravity, region=region)
    except EmptyRegionError:
        return None
    for view in surface.views:
        _ = view.image  # raises where the sensor is not outside the cloud
    if region is None and only_support_left(surface.points, region, surface.gravity):
        check_not_upside_down(surface.points, surface.gravity)
    return surface


def _floor(surface: SurfaceCloud, settings: Settings) -> list[Check]:
    floor = settings.floor
    if floor is None:
        return []
    plane = floor if isinstance(floor, Plane) else level_floor(floor, surface.gravity)
    try:
        unseen_structure(surface, floor=plane, walls=settings.region_walls)
    except InvalidRequestError as error:
        return [Check("floor", "fail", str(error))]
    return [Check("floor", "ok", "it is below the objects")]

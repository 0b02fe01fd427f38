"""What a request looks at: the cloud in it, the latest on `points`, or the latest depth image, in
the planning frame with its gravity. One way for syntheses and for finding bins.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header

from megrasp_core.errors import GravityError, InvalidRequestError, SensorPlaceError
from megrasp_ros.conversions import LABEL, cloud_from_message
from megrasp_ros.depth_messages import cloud_from_depth
from megrasp_ros.errors import SensorOriginError

from .frames import FrameSource, gravity_in, is_optical
from .parameters import Settings
from .sensor_source import SensorSource, Topic
from .stamps import StampCheck
from .worker import Job

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud, OrientedBox

FloatArray = NDArray[np.float64]

POINTS = (Topic("points", PointCloud2, "a cloud", "/camera/camera/depth/color/points"),)
ALIGNED = "/camera/camera/aligned_depth_to_color"
MASK = Topic("mask", Image, "a mask", "/segmentation/mask", optional=True)
DEPTH = (
    Topic("depth", Image, "a depth image", f"{ALIGNED}/image_raw"),
    Topic("camera_info", CameraInfo, "a camera_info", f"{ALIGNED}/camera_info"),
    MASK,
)


@dataclass(frozen=True, eq=False)
class Sensed:
    """A scene in the planning frame.

    Attributes:
        cloud: with the sensor's place as viewpoint.
        header: of the answer: the planning frame, the stamp of what was sensed.
        gravity: (3,) unit vector.
        waited: how long it was waited for (s).
        seconds: that decoding and transforming took.
        source: frame that the parameter `sensor_origin` is in; "" where the camera is at the
            origin by the nature of the frame.
        sensor_origin: that parameter.
    """

    cloud: Cloud
    header: Header
    gravity: FloatArray
    waited: float
    seconds: float
    source: str
    sensor_origin: tuple[float, ...]

    def placed(self) -> contextlib.AbstractContextManager[None]:
        """See `placed`."""
        return placed(self.source, self.sensor_origin)


@dataclass(frozen=True, eq=False)
class _View:
    """What came from a sensor, in its own frame, not decoded yet."""

    header: Header
    optical: bool
    decode: Callable[[], Cloud]
    why_unlabelled: str


class Sensing:
    """The sensors of a node; the parameter `input` says which one counts."""

    def __init__(self, node: Node, frames: FrameSource, points: str = "points") -> None:
        """`points`: the topic with clouds."""
        self._node, self._frames = node, frames
        self._stamps = StampCheck(node)
        clouds = tuple(replace(topic, name=points) for topic in POINTS)
        self._sources = {"points": SensorSource(node, clouds), "depth": SensorSource(node, DEPTH)}

    @property
    def topics(self) -> dict[str, str]:
        """Name -> the topic it is remapped to."""
        names = [topic.name for topic in (*POINTS, *DEPTH)]
        return {name: self._node.resolve_topic_name(name) for name in names}

    def source(self, name: str) -> SensorSource:
        """Return the sensor of this value of the parameter `input`."""
        return self._sources[name]

    def follow(
        self, settings: Settings, *, continuous: bool, on_arrival: Callable[[], None] | None
    ) -> None:
        """Subscribe the sensor that counts always, or only while a request waits; the others not.

        on_arrival: called for each of its messages.
        """
        for name, source in self._sources.items():
            counts = name == settings.input
            source.on_arrival = on_arrival if counts else None
            source.set_continuous(continuous and counts)

    def rest(self) -> None:
        """Subscribe nothing that no request waits for."""
        for source in self._sources.values():
            source.set_continuous(False)

    def sense(
        self,
        job: Job,
        settings: Settings,
        *,
        given: PointCloud2 | None,
        not_before: Time,
        region: OrientedBox | None = None,
        target: int | None = None,
        on_arrived: Callable[[], None] | None = None,
    ) -> Sensed:
        """Return what a request looks at.

        Args:
            job: of the request.
            settings: of the request.
            given: the cloud that came with it, None: the latest from the sensor.
            not_before: only what was stamped later; 0 for any.
            region: in the planning frame, where it alone tells about units.
            target: the object that is asked for, which needs labels.
            on_arrived: called before the work on it begins.

        Raises:
            NoCloudError, StaleCloudError, CloudError, TransformError, GravityError; what
            `job.check` raises; InvalidRequestError for a target where objects are not told apart.
        """
        from megrasp_core.pointcloud import check_view

        begun = job.elapsed
        view = self._view(job, settings, given, not_before, target)
        waited = job.elapsed - begun
        if on_arrived is not None:
            on_arrived()
        start = time.monotonic()
        frame, planning_from_cloud = self._frames.planning_from_cloud(view.header, settings)
        optical = view.optical and frame == view.header.frame_id
        gravity = gravity_in(frame, settings, optical=optical)
        cloud = view.decode()
        if target is not None and cloud.labels is None:
            raise InvalidRequestError(_no_target(target, view.why_unlabelled))
        if region is not None:
            region = region.transformed(np.linalg.inv(planning_from_cloud))
        # Gravity is looked at in the planning frame, with everything else, before the synthesis.
        check_view(cloud.points, region=region, optical=view.optical)
        job.check()
        header = Header(stamp=view.header.stamp, frame_id=frame)
        seconds = time.monotonic() - start
        return Sensed(
            cloud.transformed(planning_from_cloud),
            header,
            gravity,
            waited,
            seconds,
            "" if view.optical else view.header.frame_id,
            tuple(settings.sensor_origin.tolist()),
        )

    def _view(
        self,
        job: Job,
        settings: Settings,
        given: PointCloud2 | None,
        not_before: Time,
        target: int | None,
    ) -> _View:
        source = self.source(settings.input)
        if given is not None:
            self._stamps.given(given.header, not_before)
            return _of_cloud(given, settings, "the cloud of the request")
        if settings.input == "points":
            (cloud,) = source.wait(job, settings, not_before)
            return _of_cloud(cloud, settings, "the cloud on `points`")
        if target is not None and not source.publishers(MASK):
            name = self._node.resolve_topic_name(MASK.name)
            raise InvalidRequestError(
                _no_target(target, f"nobody publishes a mask on {name}: start the segmentation")
            )
        depth, info, mask = source.wait(job, settings, not_before)
        return _View(depth.header, True, lambda: cloud_from_depth(depth, info, mask), "no mask")


@contextlib.contextmanager
def placed(source: str, origin: Sequence[float]) -> Iterator[None]:
    """What the core finds wrong with the sensor's place is told of the parameter `sensor_origin`.

    Args:
        source: frame of the cloud, "" where the camera is at its origin.
        origin: the parameter.

    Raises:
        SensorOriginError: it is wrong, or not set in a frame that is not a camera's.
    """
    try:
        yield
    except (SensorPlaceError, GravityError) as error:
        # Beside a place that was given, it is gravity that is wrong.
        if not source or (isinstance(error, GravityError) and any(origin)):
            raise
        raise SensorOriginError(origin, source, error) from error


def _of_cloud(message: PointCloud2, settings: Settings, what: str) -> _View:
    def decode() -> Cloud:
        from megrasp_core.pointcloud import Cloud

        cloud = cloud_from_message(message)
        return Cloud(cloud.points, None, settings.sensor_origin, cloud.labels)

    why = (
        f"{what} has no field `{LABEL}` of whole numbers: add one, or set the parameter input to "
        "depth and publish a mask"
    )
    return _View(message.header, is_optical(message.header.frame_id), decode, why)


def _no_target(target: int, why: str) -> str:
    return (
        f"target is {target}, and objects are not told apart, because {why}. Or ask for any "
        "object, with target -1."
    )

"""Whether usable clouds or depth images come: publisher, type, QoS, rate, size, age."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header

from megrasp_core.pointcloud import Cloud
from megrasp_ros.conversions import points_from_cloud
from megrasp_ros.depth_messages import cloud_from_depth
from megrasp_ros.qos import SENSOR
from megrasp_ros.server.frames import is_optical
from megrasp_ros.server.parameters import Settings
from megrasp_ros.server.sensor_source import others_with

from .asked import Asked
from .check import Check

AHEAD = 1.0
"""A stamp may be ahead of the clock by so much (s)."""


@dataclass
class Sample:
    """What came on a topic within some seconds."""

    seconds: float
    sizes: list[int] = field(default_factory=list)
    last: bytes = b""

    def take(self, data: bytes) -> None:
        """Callback of a raw subscription."""
        self.sizes.append(len(data))
        self.last = data


@dataclass(frozen=True)
class Scene:
    """What the server would look at, in the frame of its sensor; decoded when it is needed."""

    header: Header
    optical: bool
    decode: Callable[[], Cloud]


class InputChecks:
    """What comes from the camera; `scene` and `cloud_bytes` are of the last that came.

    Args:
        asked: the server.
        points: topic that clouds are expected on where the server does not tell its own.
        told: what the server says of itself, see `server.health`.
        settings: its parameters, None where they could not be read.
    """

    def __init__(
        self, asked: Asked, points: str, told: Mapping[str, str], settings: Settings | None
    ) -> None:
        self._asked, self._node = asked, asked.node
        self._told, self._settings = told, settings
        self._points = asked.node.resolve_topic_name(points)
        self.scene: Scene | None = None
        self.cloud_bytes = 0

    def run(self) -> list[Check]:
        """Of clouds, or of images where the server takes these."""
        depth = getattr(self._settings, "input", "points") == "depth"
        return self.images() if depth else self.cloud()

    def cloud(self) -> list[Check]:
        """Whether usable clouds come: publisher, type, QoS, rate, size, age."""
        topic = self._told.get("topic points", self._points)
        heard = self._listened("points", {"points": (topic, PointCloud2)})
        if isinstance(heard, Check):
            return [heard]
        (sample,) = heard
        cloud: PointCloud2 = deserialize_message(sample.last, PointCloud2)
        optical = is_optical(cloud.header.frame_id)
        self.scene = Scene(cloud.header, optical, lambda: Cloud(points_from_cloud(cloud)))
        return [self._rate("points", topic, sample), self._age(cloud.header)]

    def images(self) -> list[Check]:
        """The same of depth images and their camera_info."""
        kinds = {"depth": Image, "camera_info": CameraInfo}
        names = {
            name: (self._told.get(f"topic {name}", self._node.resolve_topic_name(name)), kind)
            for name, kind in kinds.items()
        }
        heard = self._listened("images", names)
        if isinstance(heard, Check):
            return [heard]
        depth: Image = deserialize_message(heard[0].last, Image)
        info: CameraInfo = deserialize_message(heard[1].last, CameraInfo)
        self.scene = Scene(depth.header, True, lambda: cloud_from_depth(depth, info, None))
        told = ", ".join(topic for topic, _ in names.values())
        return [self._rate("images", told, heard[0]), self._age(depth.header)]

    def _listened(self, what: str, topics: dict[str, tuple[str, type]]) -> Check | list[Sample]:
        """What came on every topic, by the names that the server has for them, or what is wrong
        with one of them.
        """

        def missing() -> list[str]:
            there = self._node.get_publishers_info_by_topic
            return [name for name, (topic, _) in topics.items() if not there(topic)]

        self._asked.until(lambda: not missing())
        if silent := missing():
            return Check(what, "fail", self._unpublished({name: topics[name] for name in silent}))
        for topic, kind in topics.values():
            wrong = self._misfit(topic, kind)
            if wrong:
                return Check(what, "fail", wrong)
        samples = [Sample(self._asked.seconds) for _ in topics]
        for sample, (topic, kind) in zip(samples, topics.values(), strict=True):
            self._node.create_subscription(kind, topic, sample.take, SENSOR, raw=True)
        self._asked.pause(self._asked.seconds)
        for sample, (topic, _) in zip(samples, topics.values(), strict=True):
            if not sample.sizes:
                count = self._node.count_publishers(topic)
                text = (
                    f"{topic} has {count} publisher(s), and nothing came in "
                    f"{self._asked.seconds:g} s; see the lines `Fast DDS` and `shared memory`, or "
                    "is the camera stopped?"
                )
                return Check(what, "fail", text)
        self.cloud_bytes = max(max(sample.sizes) for sample in samples)
        return samples

    def _unpublished(self, topics: dict[str, tuple[str, type]]) -> str:
        told = f"nobody publishes {', '.join(topic for topic, _ in topics.values())}"
        hints = []
        for name, (topic, kind) in topics.items():
            others = others_with(self._node, type_name(kind), topic, self._asked.server)
            if others:
                hints.append(
                    f"; {kind.__name__} is on {', '.join(others[:5])}: start the server with -r "
                    f"{name}:={others[0]}"
                )
                if name == "points" and not self._told:
                    hints.append(f", and doctor with --points {others[0]}")
        return told + ("".join(hints) or "; start the camera")

    def _misfit(self, topic: str, kind: type) -> str:
        """What is wrong with those who publish a topic, "" where nothing is."""
        for info in self._node.get_publishers_info_by_topic(topic):
            if info.topic_type != type_name(kind):
                return (
                    f"{topic} carries {info.topic_type}; expected {type_name(kind)}. Remap to one"
                )
            compatible, reason = qos_check_compatible(info.qos_profile, SENSOR)
            if compatible == QoSCompatibility.ERROR:
                return f"QoS of {info.node_name} on {topic} does not fit the server's: {reason}"
        return ""

    def _rate(self, what: str, topic: str, sample: Sample) -> Check:
        rate = len(sample.sizes) / sample.seconds
        text = f"{topic}: {rate:.1f} a second, {self.cloud_bytes / 1e6:.2f} MB"
        timeout = 5.0 if self._settings is None else self._settings.cloud_timeout
        if rate * timeout < 2.0:
            advice = f"cloud_timeout is {timeout:g} s; raise it, or the camera's rate"
            return Check(what, "warn", f"{text}; {advice}")
        return Check(what, "ok", text)

    def _age(self, header: Header) -> Check:
        limit = 5.0 if self._settings is None else self._settings.cloud_max_age
        stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
        age = 1e-9 * self._node.get_clock().now().nanoseconds - stamp
        if limit <= 0:
            return Check("stamps", "ok", "any (cloud_max_age 0)")
        advice = "Synchronise the clocks (chrony), or set use_sim_time on both sides"
        if age < -AHEAD:
            text = f"clouds are {-age:.2f} s ahead of this machine's clock. {advice}"
            return Check("stamps", "fail", text)
        if age > limit + self._asked.seconds:
            text = f"clouds are {age:.1f} s old and cloud_max_age is {limit:g} s. {advice}"
            return Check("stamps", "fail", text)
        return Check("stamps", "ok", f"clouds are at most {max(age, 0.0):.2f} s old")


def type_name(kind: type) -> str:
    """package/msg/Name of a message."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"

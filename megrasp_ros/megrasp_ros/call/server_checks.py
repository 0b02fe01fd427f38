"""What `doctor` asks of the running system: the server, its topics, frames and region."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import MegraspError
from megrasp_core.pointcloud import check_view
from megrasp_ros.calling import GraspServerError
from megrasp_ros.client import GraspClient
from megrasp_ros.conversions import points_from_cloud
from megrasp_ros.qos import SENSOR
from megrasp_ros.recording import server_settings
from megrasp_ros.server.frames import FrameSource, gravity_in, is_optical
from megrasp_ros.server.parameters import Settings

from .machine_checks import Check, Level

CLOUD = "sensor_msgs/msg/PointCloud2"
LATCHED_TOPICS = ("grasps", "pregrasps", "approach_poses", "active_gripper")
FEW = 500
"""Fewer points than this in the region show no object well."""
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


class ServerChecks:
    """The checks, each of which returns its lines; later ones use what earlier ones found.

    Args:
        client: in the namespace of the server.
        server: name of its node.
        points: topic that clouds are expected on.
        seconds: how long topics are listened to.
        patience: longest wait (s), from the first check on, for nodes and topics to be discovered;
            a quarter of it is left to every later one.
    """

    def __init__(
        self, client: GraspClient, server: str, points: str, seconds: float, patience: float
    ) -> None:
        self._client, self._node = client, client.node
        self._server, self._seconds, self._patience = server, seconds, patience
        self._started = time.monotonic()
        self._points = self._node.resolve_topic_name(points)
        self._settings: Settings | None = None
        self._cloud: PointCloud2 | None = None
        self.cloud_bytes = 0

    def run(self) -> list[Check]:
        """All of them, in the order in which a request would meet what is wrong."""
        found = self.server()
        if any(check.level == "fail" for check in found[:1]):
            return [*found, *self.cloud()]
        found += [*self.health(), *self.parameters()]
        # A server that takes depth images has no clouds to look at.
        depth = getattr(self._settings, "input", "points") == "depth"
        found += self.images() if depth else self.cloud()
        if self._settings is not None and self._cloud is not None:
            found += self.geometry(self._settings, self._cloud)
        return [*found, *self.listeners()]

    def server(self) -> list[Check]:
        """Whether the server is there, once, and active."""
        namespace = self._node.get_namespace()

        def named() -> list[str]:
            nodes = self._node.get_node_names_and_namespaces()
            return [place for name, place in nodes if name == self._server]

        self._until(lambda: namespace in named())
        places = named()
        if namespace not in places:
            return [Check("server", "fail", self._absence(namespace, places))]
        full = f"{namespace.rstrip('/')}/{self._server}"
        if places.count(namespace) > 1:
            text = f"{places.count(namespace)} nodes are named {full}; end all but one"
            return [Check("server", "fail", text)]
        try:
            state = self._client.state()
        except GraspServerError as error:
            return [Check("server", "fail", f"{full} does not tell its state: {error}")]
        if state == "active":
            return [Check("server", "ok", f"{full} is active")]
        text = (
            f"{full} is {state}; expected active. Start it with autostart:=true (it takes some "
            "seconds), or let the lifecycle manager configure and activate it; where that fails, "
            "its log and the line `health` say why"
        )
        return [
            Check("server", "warn" if state in ("configuring", "activating") else "fail", text)
        ]

    def _absence(self, namespace: str, places: list[str]) -> str:
        if places:
            return (
                f"no {self._server} in namespace {namespace}, but in {', '.join(sorted(places))}; "
                f"give --namespace {sorted(places)[0]}"
            )
        others = [
            f"{place.rstrip('/')}/{name}"
            for name, place in self._node.get_node_names_and_namespaces()
            if name != self._node.get_name()
        ]
        if others:
            return (
                f"no node {self._server}, but {', '.join(sorted(others)[:5])}; start it: ros2 run "
                "megrasp_ros grasp_server"
            )
        return (
            "no other node is seen at all; start grasp_server in the same ROS_DOMAIN_ID, and on "
            "another machine with ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET on both"
        )

    def health(self) -> list[Check]:
        """What the server says of itself in /diagnostics."""
        full = f"{self._node.get_namespace().rstrip('/')}/{self._server}"
        heard: list[DiagnosticStatus] = []

        def take(message: DiagnosticArray) -> None:
            heard.extend(status for status in message.status if status.name == full)

        self._node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
        self._until(lambda: bool(heard))
        if not heard:
            return [Check("health", "warn", f"nothing of {full} on /diagnostics; is it stuck?")]
        status = heard[-1]
        levels: dict[bytes, Level] = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
        values = {each.key: each.value for each in status.values}
        text = status.message
        if status.level == DiagnosticStatus.OK:
            text = f"model {values.get('model')}, gripper {values.get('active gripper')}"
        return [Check("health", levels.get(status.level, "fail"), text)]

    def parameters(self) -> list[Check]:
        """Read the server's parameters; its clock has to tick."""
        try:
            self._settings = server_settings(self._client)
            simulated = self._client.parameters(["use_sim_time"]).get("use_sim_time", False)
        except (MegraspError, GraspServerError) as error:
            return [Check("parameters", "fail", str(error))]
        if simulated and not self._node.get_publishers_info_by_topic("/clock"):
            text = "use_sim_time is true and nobody publishes /clock; start it, or set it to false"
            return [Check("clock", "fail", text)]
        return [Check("clock", "ok", "/clock" if simulated else "the machine's")]

    def cloud(self) -> list[Check]:
        """Whether usable clouds come: publisher, type, QoS, rate, size, age."""
        topic = heard_cloud(self._node, self._server) or self._points
        self._until(lambda: bool(self._node.get_publishers_info_by_topic(topic)))
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            others = other_clouds(self._node, self._server, topic)
            hint = (
                f"; clouds are on {', '.join(others[:5])}: start the server with -r "
                f"points:={others[0]}, and doctor with --points {others[0]}"
                if others
                else "; start the camera"
            )
            return [Check("points", "fail", f"nobody publishes {topic}{hint}")]
        wrong = [info.topic_type for info in publishers if info.topic_type != CLOUD]
        if wrong:
            text = f"{topic} carries {wrong[0]}; expected {CLOUD}. Remap points to a cloud"
            return [Check("points", "fail", text)]
        for info in publishers:
            compatible, reason = qos_check_compatible(info.qos_profile, SENSOR)
            if compatible == QoSCompatibility.ERROR:
                text = f"QoS of {info.node_name} on {topic} does not fit the server's: {reason}"
                return [Check("points", "fail", text)]
        sample = Sample(self._seconds)
        self._node.create_subscription(PointCloud2, topic, sample.take, SENSOR, raw=True)
        self._pause(self._seconds)
        if not sample.sizes:
            text = (
                f"{topic} has {len(publishers)} publisher(s), and no cloud came in "
                f"{self._seconds:g} s; see the lines `Fast DDS` and `shared memory`, or is the "
                "camera stopped?"
            )
            return [Check("points", "fail", text)]
        self.cloud_bytes = max(sample.sizes)
        cloud: PointCloud2 = deserialize_message(sample.last, PointCloud2)
        self._cloud = cloud
        return [self._rate(topic, sample), self._age(cloud)]

    def images(self) -> list[Check]:
        """Whether somebody publishes depth images and what the camera is like."""
        topics = [self._node.resolve_topic_name(name) for name in ("depth", "camera_info")]

        def missing() -> list[str]:
            return [name for name in topics if not self._node.get_publishers_info_by_topic(name)]

        self._until(lambda: not missing())
        if missing():
            text = f"nobody publishes {', '.join(missing())}; start the camera, or remap them"
            return [Check("images", "fail", text)]
        return [Check("images", "ok", ", ".join(topics))]

    def _rate(self, topic: str, sample: Sample) -> Check:
        rate = len(sample.sizes) / sample.seconds
        text = f"{topic}: {rate:.1f} a second, {self.cloud_bytes / 1e6:.2f} MB"
        timeout = 5.0 if self._settings is None else self._settings.cloud_timeout
        if rate * timeout < 2.0:
            advice = f"cloud_timeout is {timeout:g} s; raise it, or the camera's rate"
            return Check("points", "warn", f"{text}; {advice}")
        return Check("points", "ok", text)

    def _age(self, cloud: PointCloud2) -> Check:
        limit = 5.0 if self._settings is None else self._settings.cloud_max_age
        stamp = cloud.header.stamp.sec + 1e-9 * cloud.header.stamp.nanosec
        age = 1e-9 * self._node.get_clock().now().nanoseconds - stamp
        if limit <= 0:
            return Check("stamps", "ok", "any (cloud_max_age 0)")
        advice = "Synchronise the clocks (chrony), or set use_sim_time on both sides"
        if age < -AHEAD:
            text = f"clouds are {-age:.2f} s ahead of this machine's clock. {advice}"
            return Check("stamps", "fail", text)
        if age > limit + self._seconds:
            text = f"clouds are {age:.1f} s old and cloud_max_age is {limit:g} s. {advice}"
            return Check("stamps", "fail", text)
        return Check("stamps", "ok", f"clouds are at most {max(age, 0.0):.2f} s old")

    def geometry(self, settings: Settings, cloud: PointCloud2) -> list[Check]:
        """Frames, gravity, units, region: the same functions that a request goes through."""
        source = cloud.header.frame_id
        if not source:
            text = "the cloud's frame_id is empty; set the frame in the camera's driver"
            return [Check("frame", "fail", text)]
        frames = FrameSource(self._node)
        try:
            frames.listen(settings)
            if settings.planning_frame and settings.extrinsics is None:
                # What tf2 has to say comes within a second or two.
                self._pause(min(2.0, self._seconds))
            frame, matrix = frames.planning_from_cloud(cloud.header, settings)
        except MegraspError as error:
            return [Check("frame", "fail", str(error))]
        found = [Check("frame", "ok", frames.last)]
        try:
            gravity = gravity_in(frame, settings)
        except MegraspError as error:
            return [*found, Check("gravity", "fail", str(error))]
        given = "parameter" if settings.gravity is not None else "z is up"
        numbers = " ".join(f"{value:.3g}" for value in gravity)
        found.append(Check("gravity", "ok", f"{numbers} in {frame!r} ({given})"))
        try:
            seen = points_from_cloud(cloud)
        except MegraspError as error:
            return [*found, Check("view", "fail", str(error))]
        points = seen @ matrix[:3, :3].T + matrix[:3, 3]
        sensor = matrix[:3, :3] @ settings.sensor_origin + matrix[:3, 3]
        try:
            if is_optical(source):
                check_view(seen, optical=True)
            check_view(points, sensor=sensor, gravity=gravity, region=settings.region)
            found.append(Check("view", "ok", "units, axes, gravity and the sensor's place agree"))
        except MegraspError as error:
            found.append(Check("view", "fail", str(error)))
        return [*found, self._region(settings, points)]

    def _region(self, settings: Settings, points: NDArray[np.float64]) -> Check:
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
        return Check("region", "ok", f"{inside} points in it")

    def listeners(self) -> list[Check]:
        """Whether those who listen to the server's topics hear them."""
        found = []
        for name in LATCHED_TOPICS:
            topic = self._node.resolve_topic_name(name)
            offered = self._node.get_publishers_info_by_topic(topic)
            for info in self._node.get_subscriptions_info_by_topic(topic):
                if not offered or info.node_name == self._node.get_name():
                    continue
                found.append(_heard(topic, offered[0].qos_profile, info))
        wrong = [check for check in found if check is not None]
        return wrong or [Check("listeners", "ok", "all hear what they subscribe to")]

    def _until(self, done: Callable[[], bool]) -> None:
        """Wait for what the network has yet to tell: who has listened for long has heard it."""
        end = max(self._started + self._patience, time.monotonic() + self._patience / 4)
        while not done() and time.monotonic() < end:
            self._pause(0.05)

    def _pause(self, seconds: float) -> None:
        if not self._node.context.ok():
            raise ExternalShutdownException
        time.sleep(seconds)


def heard_cloud(node: Node, server: str) -> str:
    """The topic that the server has clouds from, "" while it is not subscribed: itself it tells
    which one it was remapped to.
    """
    try:
        listened = node.get_subscriber_names_and_types_by_node(server, node.get_namespace())
    except Exception:
        return ""
    return next((name for name, kinds in listened if CLOUD in kinds), "")


def other_clouds(node: Node, server: str, topic: str) -> list[str]:
    """Topics with clouds, but `topic`, that somebody else than the server publishes."""
    return sorted(
        name
        for name, kinds in node.get_topic_names_and_types()
        if CLOUD in kinds
        and name != topic
        and any(info.node_name != server for info in node.get_publishers_info_by_topic(name))
    )


def _heard(topic: str, offered: QoSProfile, info) -> Check | None:
    who = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    compatible, reason = qos_check_compatible(offered, info.qos_profile)
    if compatible == QoSCompatibility.ERROR:
        return Check("listeners", "fail", f"{who} hears nothing of {topic}: {reason}")
    if info.qos_profile.durability == DurabilityPolicy.VOLATILE:
        text = (
            f"{who} subscribes to {topic} with durability volatile and misses what was published "
            "before; take transient local"
        )
        return Check("listeners", "warn", text)
    return None

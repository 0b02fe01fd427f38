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
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header

from megrasp_core.errors import EmptyRegionError, InvalidRequestError, MegraspError
from megrasp_core.pointcloud import (
    Cloud,
    DepthImage,
    Plane,
    SurfaceCloud,
    check_not_upside_down,
    check_view,
    level_floor,
    only_support_left,
    surface_cloud,
    unseen_structure,
)
from megrasp_ros.calling import GraspServerError
from megrasp_ros.client import GraspClient
from megrasp_ros.conversions import points_from_cloud
from megrasp_ros.depth_messages import cloud_from_depth
from megrasp_ros.errors import in_ros_words
from megrasp_ros.qos import SENSOR
from megrasp_ros.recording import server_settings
from megrasp_ros.server.diagnostics import UNREPORTED
from megrasp_ros.server.frames import FrameSource, gravity_in, is_optical
from megrasp_ros.server.parameters import Settings
from megrasp_ros.server.sensing import placed
from megrasp_ros.server.sensor_source import others_with

from .machine_checks import Check, Level

LATCHED_TOPICS = ("grasps", "pregrasps", "approach_poses", "active_gripper")
FEW = 500
"""Fewer points than this in the region show no object well."""
AHEAD = 1.0
"""A stamp may be ahead of the clock by so much (s)."""
TWINS = 2.0
"""A second server of the same name is discovered within this time (s) after the first."""
TOLD = 2.0
"""A server that runs tells of itself each second; so long it is listened to (s)."""


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
        self._scene: Scene | None = None
        self._told: dict[str, str] = {}
        self.cloud_bytes = 0

    def run(self) -> list[Check]:
        """All of them, in the order in which a request would meet what is wrong."""
        found = self.server()
        if self._count() == 1:
            # Also of one that is not active: it says why.
            found += self.health()
        if found[0].level == "fail":
            return [*found, *self.cloud()]
        found += self.parameters()
        # A server that takes depth images has no clouds to look at.
        depth = getattr(self._settings, "input", "points") == "depth"
        found += self.images() if depth else self.cloud()
        if self._settings is not None and self._scene is not None:
            found += self.geometry(self._settings, self._scene)
        return [*found, *self.listeners()]

    def server(self) -> list[Check]:
        """Whether the server is there, once, and active."""
        namespace = self._node.get_namespace()
        self._until(lambda: self._count() > 0)
        self._until(lambda: self._count() > 1, TWINS)
        if not self._count():
            return [Check("server", "fail", self._absence(namespace, self._places()))]
        full = f"{namespace.rstrip('/')}/{self._server}"
        if self._count() > 1:
            text = f"{self._count()} nodes are named {full}; end all but one"
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

    def _places(self) -> list[str]:
        """Namespaces in which there is a node of that name, one that has several more often."""
        nodes = self._node.get_node_names_and_namespaces()
        return [place for name, place in nodes if name == self._server]

    def _count(self) -> int:
        return self._places().count(self._node.get_namespace())

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
        status = server_status(self._node, self._server, self._until)
        if status is None:
            text = f"nothing of {self._server} on /diagnostics; is it stuck?"
            return [Check("health", "warn", text)]
        levels: dict[bytes, Level] = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
        values = self._told = {each.key: each.value for each in status.values}
        text, level = status.message, levels.get(status.level, "fail")
        active, tool = values.get("active gripper", ""), values.get("tool_id", UNREPORTED)
        if level == "ok":
            text = f"model {values.get('model')}, gripper {active}"
        elif level == "warn" and tool not in (UNREPORTED, active):
            level = "fail"
            text += (
                f": requests answer 203. Call set_gripper with the gripper that is on, or mount "
                f"{active}"
            )
        return [Check("health", level, text)]

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
        topic = self._told.get("topic points", self._points)
        heard = self._listened("points", {"points": (topic, PointCloud2)})
        if isinstance(heard, Check):
            return [heard]
        (sample,) = heard
        cloud: PointCloud2 = deserialize_message(sample.last, PointCloud2)
        optical = is_optical(cloud.header.frame_id)
        self._scene = Scene(cloud.header, optical, lambda: Cloud(points_from_cloud(cloud)))
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
        self._scene = Scene(depth.header, True, lambda: cloud_from_depth(depth, info, None))
        told = ", ".join(topic for topic, _ in names.values())
        return [self._rate("images", told, heard[0]), self._age(depth.header)]

    def _listened(self, what: str, topics: dict[str, tuple[str, type]]) -> Check | list[Sample]:
        """What came on every topic, by the names that the server has for them, or what is wrong
        with one of them.
        """

        def missing() -> list[str]:
            there = self._node.get_publishers_info_by_topic
            return [name for name, (topic, _) in topics.items() if not there(topic)]

        self._until(lambda: not missing())
        if silent := missing():
            return Check(what, "fail", self._unpublished({name: topics[name] for name in silent}))
        for topic, kind in topics.values():
            wrong = self._misfit(topic, kind)
            if wrong:
                return Check(what, "fail", wrong)
        samples = [Sample(self._seconds) for _ in topics]
        for sample, (topic, kind) in zip(samples, topics.values(), strict=True):
            self._node.create_subscription(kind, topic, sample.take, SENSOR, raw=True)
        self._pause(self._seconds)
        for sample, (topic, _) in zip(samples, topics.values(), strict=True):
            if not sample.sizes:
                count = self._node.count_publishers(topic)
                text = (
                    f"{topic} has {count} publisher(s), and nothing came in {self._seconds:g} s; "
                    "see the lines `Fast DDS` and `shared memory`, or is the camera stopped?"
                )
                return Check(what, "fail", text)
        self.cloud_bytes = max(max(sample.sizes) for sample in samples)
        return samples

    def _unpublished(self, topics: dict[str, tuple[str, type]]) -> str:
        told = f"nobody publishes {', '.join(topic for topic, _ in topics.values())}"
        hints = []
        for name, (topic, kind) in topics.items():
            others = others_with(self._node, type_name(kind), topic, self._server)
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
        if age > limit + self._seconds:
            text = f"clouds are {age:.1f} s old and cloud_max_age is {limit:g} s. {advice}"
            return Check("stamps", "fail", text)
        return Check("stamps", "ok", f"clouds are at most {max(age, 0.0):.2f} s old")

    def geometry(self, settings: Settings, scene: Scene) -> list[Check]:
        """Frames, gravity, units, region: the same functions that a request goes through."""
        source = scene.header.frame_id
        if not source:
            text = "the cloud's frame_id is empty; set the frame in the camera's driver"
            return [Check("frame", "fail", text)]
        frames = FrameSource(self._node)
        try:
            frames.listen(settings)
            if settings.planning_frame and settings.extrinsics is None:
                # What tf2 has to say comes within a second or two.
                self._pause(min(2.0, self._seconds))
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
        return [*found, self._region(settings, cloud.points)]

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
        doubt = settings.region.doubt(points)
        if doubt:
            return Check("region", "warn", doubt)
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

    def _until(self, done: Callable[[], bool], seconds: float | None = None) -> None:
        """Wait for what the network has yet to tell: who has listened for long has heard it.

        seconds: from now on, in place of the patience.
        """
        now = time.monotonic()
        if seconds is None:
            end = max(self._started + self._patience, now + self._patience / 4)
        else:
            end = now + seconds
        while not done() and time.monotonic() < end:
            self._pause(0.05)

    def _pause(self, seconds: float) -> None:
        if not self._node.context.ok():
            raise ExternalShutdownException
        time.sleep(seconds)


def type_name(kind: type) -> str:
    """package/msg/Name of a message."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def server_status(
    node: Node, server: str, until: Callable[[Callable[[], bool]], object]
) -> DiagnosticStatus | None:
    """What the server says of itself in /diagnostics, None when it says nothing.

    until: waits for a condition.
    """
    full = f"{node.get_namespace().rstrip('/')}/{server}"
    heard: list[DiagnosticStatus] = []

    def take(message: DiagnosticArray) -> None:
        heard[:] = [status for status in message.status if status.name == full] or heard

    node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    until(lambda: bool(heard))
    return heard[-1] if heard else None


def cloud_topic(node: Node, server: str) -> str:
    """The topic that the server's `points` is remapped to, "" where no server tells."""
    if (server, node.get_namespace()) not in node.get_node_names_and_namespaces():
        return ""
    end = time.monotonic() + TOLD

    def until(done: Callable[[], bool]) -> None:
        while not done() and time.monotonic() < end:
            time.sleep(0.05)

    status = server_status(node, server, until)
    values = {} if status is None else {each.key: each.value for each in status.values}
    return values.get("topic points", "")


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
        DepthImage(view.points, view.sensor)
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

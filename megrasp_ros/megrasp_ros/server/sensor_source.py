"""The latest from a sensor, of one topic or of several that belong together: kept as received
bytes, decoded only when a request needs it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time as TimeMessage
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from megrasp_ros.errors import NoCloudError, StaleCloudError
from megrasp_ros.qos import SENSOR

from .parameters import Settings
from .stamps import StampCheck, check_header, nanoseconds
from .worker import Job

MOST_BYTES = 128 * 2**20
"""Messages of a topic that wait for those of another one, such as depth images for a mask."""

LEAST_KEPT, MOST_KEPT = 4, 100


@dataclass(frozen=True)
class Topic:
    """A topic of a sensor.

    Attributes:
        name: relative, to be remapped.
        kind: of its messages, which begin with a header.
        what: for messages to people.
        remap: a name that cameras give it.
        optional: belongs to it only where somebody publishes it.
    """

    name: str
    kind: type
    what: str
    remap: str
    optional: bool = False


@dataclass(frozen=True)
class _Arrival:
    number: int
    stamp: int
    data: bytes


class SensorSource:
    """Subscribes its topics while somebody waits (on demand) or always (continuous).

    Messages of several topics belong together by their stamps; the first topic says when that is.
    The callbacks only store bytes: at 30 clouds of 5 MB a second, decoding each would cost a core.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        self._node, self._topics = node, tuple(topics)
        self._stamps = StampCheck(node)
        self._group = ReentrantCallbackGroup()
        self._changed = threading.Condition()
        self._subscriptions: list[Subscription] = []
        self._kept: dict[str, deque[_Arrival]] = {topic.name: deque() for topic in topics}
        self._users = 0
        self._continuous = False
        self._count = 0
        self._arrivals: deque[float] = deque(maxlen=16)
        self.on_arrival: Callable[[], None] | None = None

    @property
    def count(self) -> int:
        """Messages of the first topic received so far."""
        return self._count

    @property
    def rate(self) -> float:
        """The same a second, over the last arrivals; 0 when unknown."""
        times = list(self._arrivals)
        return (
            (len(times) - 1) / (times[-1] - times[0])
            if len(times) > 1 and times[-1] > times[0]
            else 0.0
        )

    @property
    def silence(self) -> float:
        """Seconds since the last one arrived; infinite before the first."""
        return time.monotonic() - self._arrivals[-1] if self._arrivals else float("inf")

    def publishers(self, topic: Topic) -> int:
        """Return how many publishers a topic has."""
        return self._node.count_publishers(self._full(topic))

    def set_continuous(self, continuous: bool) -> None:
        """Subscribe always, or only while a request waits."""
        with self._changed:
            self._continuous = continuous
            self._update()

    def wait(self, job: Job, settings: Settings, not_before: TimeMessage) -> list[Any]:
        """Return the newest messages that belong together and are young enough, one for each
        topic, None for an optional one that nobody publishes; wait for them up to
        `settings.cloud_timeout`.

        not_before: stamps must be later; 0 for any.

        Raises NoCloudError when a topic stays silent; StaleCloudError when only others arrive, or
        such as do not belong together; CloudError for those without a frame; and what `job.check`
        raises.
        """
        wanted = [each for each in self._topics if not each.optional or self.publishers(each)]
        job.waits_for = " and ".join(
            f"{each.what} on {self._full(each)}, which has {self.publishers(each)} publisher(s)"
            for each in wanted
        )
        try:
            return self._wait(job, settings, not_before, wanted)
        finally:
            job.waits_for = ""

    def _wait(
        self, job: Job, settings: Settings, not_before: TimeMessage, wanted: list[Topic]
    ) -> list[Any]:
        deadline = time.monotonic() + settings.cloud_timeout
        newest: Header | None = None
        seen = 0
        with self._changed:
            if not self._continuous and not self._users:
                # What an earlier request has left may be old; this one wants the scene as it is
                # now.
                self._forget()
            self._users += 1
            self._update()
        try:
            while True:
                with self._changed:
                    while True:
                        found = self._newest(seen, wanted, settings.sync_tolerance)
                        if found is not None or time.monotonic() >= deadline:
                            break
                        job.check()
                        self._changed.wait(0.05)
                job.check()
                if found is not None:
                    seen, messages = found[0].number, self._decoded(found, wanted)
                    header: Header = messages[0].header
                    check_header(header)
                    if not self._stamps.unusable(header, settings.cloud_max_age, not_before):
                        return messages
                    newest = header
                if time.monotonic() >= deadline:
                    raise self._failure(newest, settings, not_before, wanted)
        finally:
            with self._changed:
                self._users -= 1
                self._update()

    def _newest(self, seen: int, wanted: list[Topic], tolerance: float) -> list[_Arrival] | None:
        """Return the newest arrivals that belong together, later than number `seen`."""
        first, *others = wanted
        for arrival in reversed(self._kept[first.name]):
            if arrival.number <= seen:
                return None
            near = [self._nearest(each, arrival.stamp) for each in others]
            if all(n and abs(n.stamp - arrival.stamp) <= 1e9 * tolerance for n in near):
                return [arrival, *(each for each in near if each is not None)]
        return None

    def _nearest(self, topic: Topic, stamp: int) -> _Arrival | None:
        # Of equally near ones the newest.
        there = reversed(self._kept[topic.name])
        return min(there, key=lambda each: abs(each.stamp - stamp), default=None)

    def _decoded(self, found: list[_Arrival], wanted: list[Topic]) -> list[Any]:
        messages = {
            topic.name: deserialize_message(arrival.data, topic.kind)
            for topic, arrival in zip(wanted, found, strict=True)
        }
        return [messages.get(topic.name) for topic in self._topics]

    def _update(self) -> None:
        wanted = self._continuous or self._users > 0
        if wanted and not self._subscriptions:
            self._subscriptions = [
                self._node.create_subscription(
                    topic.kind,
                    topic.name,
                    partial(self._store, topic),
                    SENSOR,
                    callback_group=self._group,
                    raw=True,
                )
                for topic in self._topics
            ]
        elif not wanted and self._subscriptions:
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._subscriptions = []
            self._forget()

    def _forget(self) -> None:
        for kept in self._kept.values():
            kept.clear()

    def _store(self, topic: Topic, data: bytes) -> None:
        # Only the beginning is decoded.
        stamp = nanoseconds(deserialize_message(data, Header))
        is_first, kept = topic is self._topics[0], self._kept[topic.name]
        with self._changed:
            if is_first:
                self._count += 1
                self._arrivals.append(time.monotonic())
            kept.append(_Arrival(self._count, stamp, data))
            while len(kept) > self._room(len(data)):
                kept.popleft()
            self._changed.notify_all()
        if is_first and self.on_arrival is not None:
            self.on_arrival()

    def _room(self, size: int) -> int:
        """Return how many messages of `size` bytes are kept; alone, a message waits for none."""
        if len(self._topics) == 1:
            return 1
        return min(MOST_KEPT, max(LEAST_KEPT, MOST_BYTES // max(1, size)))

    def _failure(
        self,
        newest: Header | None,
        settings: Settings,
        not_before: TimeMessage,
        wanted: list[Topic],
    ) -> NoCloudError | StaleCloudError:
        timeout, first = settings.cloud_timeout, wanted[0]
        if newest is not None:
            return StaleCloudError(
                f"the newest {first.what.split(' ', 1)[1]} on {self._full(first)} after "
                f"{timeout:.3g} s cannot be used: "
                f"{self._stamps.unusable(newest, settings.cloud_max_age, not_before)}. Check that "
                "the camera publishes, that its clock (or use_sim_time) agrees with this node's, "
                "or raise cloud_max_age or cloud_timeout."
            )
        missing = [each for each in wanted if not self._kept[each.name]]
        if missing:
            return NoCloudError(" ".join(self._silent(each, timeout) for each in missing))
        with self._changed:
            last = self._kept[first.name][-1].stamp
            apart = {each: self._nearest(each, last) for each in wanted[1:]}
        told = ", ".join(
            f"the nearest on {self._full(topic)} {1e-9 * (near.stamp - last):+.4f} s from it"
            for topic, near in apart.items()
            if near is not None
        )
        return StaleCloudError(
            f"within {timeout:.3g} s no messages of one moment arrived: the last "
            f"{first.what.split(' ', 1)[1]} on {self._full(first)} is stamped {1e-9 * last:.4f}, "
            f"{told}; expected the same stamp, within sync_tolerance, "
            f"{settings.sync_tolerance:g} s. Let the drivers copy the stamp of the depth image, "
            "raise cloud_timeout if they answer late, or sync_tolerance; or stop the publisher of "
            "the mask if objects need not be told apart."
        )

    def _silent(self, topic: Topic, timeout: float) -> str:
        publishers = self._node.get_publishers_info_by_topic(self._full(topic))
        described = ", ".join(
            f"{info.node_namespace.rstrip('/')}/{info.node_name} ({info.topic_type}, "
            f"{info.qos_profile.reliability.name.lower().replace('_', ' ')})"
            for info in publishers
        )
        kind = topic.kind
        package = kind.__module__.partition(".")[0]
        there = others_with(
            self._node, f"{package}/msg/{kind.__name__}", self._full(topic), self._node.get_name()
        )
        remap = there[0] if there and kind is PointCloud2 else topic.remap
        return (
            f"no {topic.what.split(' ', 1)[1]} arrived on {self._full(topic)} within "
            f"{timeout:.3g} s; it has {len(publishers)} publisher(s)"
            f"{': ' + described if described else ''}. Expected {package}/msg/{kind.__name__}"
            f"{', which is on ' + ', '.join(there[:5]) if there else ''}. "
            f"Start the camera, remap the topic (--ros-args -r {topic.name}:={remap}), or "
            "put the cloud into the request. For large messages set "
            "FASTRTPS_DEFAULT_PROFILES_FILE to the shipped profile."
        )

    def _full(self, topic: Topic) -> str:
        """Name after remapping."""
        return self._node.resolve_topic_name(topic.name)


def others_with(node: Node, kind: str, topic: str, server: str) -> list[str]:
    """Topics of a type (package/msg/Name), but `topic`, of other nodes than `server`."""
    return sorted(
        name
        for name, kinds in node.get_topic_names_and_types()
        if kind in kinds
        and name != topic
        and any(info.node_name != server for info in node.get_publishers_info_by_topic(name))
    )

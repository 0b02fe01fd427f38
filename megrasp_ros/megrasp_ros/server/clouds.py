"""The latest cloud on `points`: kept as received bytes, decoded only when a request needs it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from builtin_interfaces.msg import Time as TimeMessage
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from megrasp_core.errors import CloudError
from megrasp_ros.errors import NoCloudError, StaleCloudError
from megrasp_ros.qos import SENSOR

from .worker import Job

TOPIC = "points"

FUTURE = 1.0
"""A stamp may lie this far (s) ahead of the node's clock."""


class CloudSource:
    """Subscribes `points` while somebody waits (on demand) or always (continuous).

    The callback only stores bytes: at 30 clouds of 5 MB a second, decoding each would cost a core.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = ReentrantCallbackGroup()
        self._changed = threading.Condition()
        self._subscription: Subscription | None = None
        self._users = 0
        self._continuous = False
        self._data: bytes | None = None
        self._count = 0
        self._arrivals: deque[float] = deque(maxlen=16)
        self.on_cloud: Callable[[], None] | None = None

    @property
    def count(self) -> int:
        """Clouds received so far."""
        return self._count

    @property
    def rate(self) -> float:
        """Clouds a second over the last arrivals; 0 when unknown."""
        times = list(self._arrivals)
        return (
            (len(times) - 1) / (times[-1] - times[0])
            if len(times) > 1 and times[-1] > times[0]
            else 0.0
        )

    @property
    def silence(self) -> float:
        """Seconds since the last cloud arrived; infinite before the first."""
        return time.monotonic() - self._arrivals[-1] if self._arrivals else float("inf")

    @property
    def topic(self) -> str:
        """Full name of the topic after remapping."""
        return self._node.resolve_topic_name(TOPIC)

    def set_continuous(self, continuous: bool) -> None:
        """Subscribe always, or only while a request waits."""
        with self._changed:
            self._continuous = continuous
            self._update()

    def check_given(self, cloud: PointCloud2, not_before: TimeMessage) -> None:
        """Check a cloud that came with a request: its frame and its stamp, but not its age.

        Raises CloudError, StaleCloudError.
        """
        _check_header(cloud)
        wrong = self._before(cloud, not_before) or self._ahead(cloud)
        if wrong:
            raise StaleCloudError(
                f"the cloud of the request cannot be used: {wrong}. Send a cloud of the scene as "
                "it is now, and see to it that the clocks (use_sim_time) of both nodes agree."
            )

    def wait(
        self, job: Job, *, timeout: float, max_age: float, not_before: TimeMessage
    ) -> PointCloud2:
        """Return the newest cloud that is young enough; wait for one up to `timeout` seconds.

        max_age: oldest stamp that is accepted (s), 0 for any. not_before: stamps must be later; 0
        for any.

        Raises NoCloudError when none arrives, StaleCloudError when only others do, CloudError for
        one without a frame, and what `job.check` raises.
        """
        publishers = self._node.count_publishers(self.topic)
        job.waits_for = f"a cloud on {self.topic}, which has {publishers} publisher(s)"
        try:
            return self._wait(job, timeout, max_age, not_before)
        finally:
            job.waits_for = ""

    def _wait(
        self, job: Job, timeout: float, max_age: float, not_before: TimeMessage
    ) -> PointCloud2:
        deadline = time.monotonic() + timeout
        newest: PointCloud2 | None = None
        with self._changed:
            if not self._continuous and not self._users:
                # What an earlier request has left may be old; this one wants the scene as it is
                # now.
                self._data = None
            seen = 0 if self._data is not None else self._count
            self._users += 1
            self._update()
        try:
            while True:
                with self._changed:
                    while self._count == seen and time.monotonic() < deadline:
                        job.check()
                        self._changed.wait(0.05)
                    data, fresh, seen = self._data, self._count != seen, self._count
                job.check()
                if fresh and data is not None:
                    message: PointCloud2 = deserialize_message(data, PointCloud2)
                    newest = message
                    _check_header(message)
                    if not self._unusable(message, max_age, not_before):
                        return message
                if time.monotonic() >= deadline:
                    raise self._failure(newest, timeout, max_age, not_before)
        finally:
            with self._changed:
                self._users -= 1
                self._update()

    def _update(self) -> None:
        wanted = self._continuous or self._users > 0
        if wanted and self._subscription is None:
            self._subscription = self._node.create_subscription(
                PointCloud2, TOPIC, self._store, SENSOR, callback_group=self._group, raw=True
            )
        elif not wanted and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _store(self, data: bytes) -> None:
        with self._changed:
            self._data = data
            self._count += 1
            self._arrivals.append(time.monotonic())
            self._changed.notify_all()
        if self.on_cloud is not None:
            self.on_cloud()

    def _now(self) -> int:
        """Return the node's time (ns); 0 with use_sim_time as long as no /clock has arrived."""
        return self._node.get_clock().now().nanoseconds

    def _unusable(self, cloud: PointCloud2, max_age: float, not_before: TimeMessage) -> str:
        """Return why a cloud of the topic is not used, "" when it is."""
        early = self._before(cloud, not_before)
        if early or max_age <= 0:
            return early
        now = self._now()
        if now == 0:
            return (
                "its age is not known, because use_sim_time is true and no /clock has arrived "
                "(start its publisher, or set cloud_max_age to 0)"
            )
        age = 1e-9 * (now - _stamp(cloud))
        if age > max_age:
            return f"its stamp is {age:.3f} s old and cloud_max_age is {max_age:g} s"
        return self._ahead(cloud)

    def _ahead(self, cloud: PointCloud2) -> str:
        now = self._now()
        ahead = 1e-9 * (_stamp(cloud) - now)
        if now == 0 or ahead <= FUTURE:
            return ""
        return f"its stamp is {ahead:.3f} s ahead of this node's clock"

    @staticmethod
    def _before(cloud: PointCloud2, not_before: TimeMessage) -> str:
        stamp, limit = _stamp(cloud), Time.from_msg(not_before).nanoseconds
        if limit and stamp <= limit:
            return f"its stamp is {1e-9 * (limit - stamp):.3f} s before not_before"
        return ""

    def _failure(
        self, newest: PointCloud2 | None, timeout: float, max_age: float, not_before: TimeMessage
    ) -> NoCloudError | StaleCloudError:
        if newest is not None:
            return StaleCloudError(
                f"the newest cloud on {self.topic} after {timeout:.3g} s cannot be used: "
                f"{self._unusable(newest, max_age, not_before)}. Check that the camera publishes, "
                "that its clock (or use_sim_time) agrees with this node's, or raise cloud_max_age "
                "or cloud_timeout."
            )
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        described = ", ".join(
            f"{info.node_namespace.rstrip('/')}/{info.node_name} ({info.topic_type}, "
            f"{info.qos_profile.reliability.name.lower().replace('_', ' ')})"
            for info in publishers
        )
        return NoCloudError(
            f"no cloud arrived on {self.topic} within {timeout:.3g} s; it has {len(publishers)} "
            "publisher(s)"
            f"{': ' + described if described else ''}. Expected sensor_msgs/msg/PointCloud2. "
            "Start the camera, remap "
            "the topic (--ros-args -r points:=/camera/depth/color/points), or put the cloud into "
            "the request. "
            "For large clouds set FASTRTPS_DEFAULT_PROFILES_FILE to the shipped profile."
        )


def _stamp(cloud: PointCloud2) -> int:
    return cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec


def _check_header(cloud: PointCloud2) -> None:
    if cloud.header.stamp.sec < 0:
        raise CloudError(
            f"the cloud's stamp is {cloud.header.stamp.sec} s; expected a time since 1970, or 0. "
            "The publisher fills the message wrongly."
        )
    if not cloud.header.frame_id:
        raise CloudError(
            "the cloud's header.frame_id is empty; expected the frame of its points. Set the "
            "frame in the camera's driver."
        )

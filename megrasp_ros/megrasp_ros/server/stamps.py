"""Whether what a sensor sent is of the time that a request wants."""

from __future__ import annotations

from builtin_interfaces.msg import Time as TimeMessage
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Header

from megrasp_core.errors import CloudError
from megrasp_ros.errors import StaleCloudError, shortened

LONGEST_NAME = 255
"""Of a frame: it comes back in every answer."""

FUTURE = 1.0
"""A stamp may lie this far (s) ahead of the node's clock."""


def nanoseconds(header: Header) -> int:
    """Return the stamp (ns); negative where somebody filled it wrongly."""
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def check_header(header: Header) -> None:
    """Raise CloudError for a header without a frame or from before 1970."""
    if header.stamp.sec < 0:
        raise CloudError(
            f"the cloud's stamp is {header.stamp.sec} s; expected a time since 1970, or 0. "
            "The publisher fills the message wrongly."
        )
    if not header.frame_id:
        raise CloudError(
            "the cloud's header.frame_id is empty; expected the frame of its points. Set the "
            "frame in the camera's driver."
        )
    if len(header.frame_id) > LONGEST_NAME:
        raise CloudError(
            f"the cloud's header.frame_id has {len(header.frame_id)} characters, "
            f"{shortened(header.frame_id, 40)!r}; expected the name of a frame. The publisher "
            "fills the message wrongly."
        )


class StampCheck:
    """Compares stamps with the node's clock and with what a request says."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def given(self, header: Header, not_before: TimeMessage) -> None:
        """Check a cloud that came with a request: its frame and its stamp, but not its age.

        Raises CloudError, StaleCloudError.
        """
        check_header(header)
        wrong = self._before(header, not_before) or self._ahead(header)
        if wrong:
            raise StaleCloudError(
                f"the cloud of the request cannot be used: {wrong}. Send a cloud of the scene as "
                "it is now, and see to it that the clocks (use_sim_time) of both nodes agree."
            )

    def unusable(self, header: Header, max_age: float, not_before: TimeMessage) -> str:
        """Return why what came from a topic is not used, "" when it is.

        max_age: oldest stamp that is accepted (s), 0 for any. not_before: stamps must be later; 0
        for any.
        """
        early = self._before(header, not_before)
        if early or max_age <= 0:
            return early
        now = self._now()
        if now == 0:
            return (
                "its age is not known, because use_sim_time is true and no /clock has arrived "
                "(start its publisher, or set cloud_max_age to 0)"
            )
        age = 1e-9 * (now - nanoseconds(header))
        if age > max_age:
            return f"its stamp is {age:.3f} s old and cloud_max_age is {max_age:g} s"
        return self._ahead(header)

    def _now(self) -> int:
        """Return the node's time (ns); 0 with use_sim_time as long as no /clock has arrived."""
        return self._node.get_clock().now().nanoseconds

    def _ahead(self, header: Header) -> str:
        now = self._now()
        ahead = 1e-9 * (nanoseconds(header) - now)
        if now == 0 or ahead <= FUTURE:
            return ""
        return f"its stamp is {ahead:.3f} s ahead of this node's clock"

    @staticmethod
    def _before(header: Header, not_before: TimeMessage) -> str:
        stamp, limit = nanoseconds(header), Time.from_msg(not_before).nanoseconds
        if limit and stamp <= limit:
            return f"its stamp is {1e-9 * (limit - stamp):.3f} s before not_before"
        return ""

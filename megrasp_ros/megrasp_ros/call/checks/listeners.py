"""Whether those who listen to the server's topics hear them."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible

from .check import Check

LATCHED_TOPICS = ("grasps", "pregrasps", "approach_poses", "active_gripper")


def listeners(node: Node) -> list[Check]:
    """A line for each of them that does not, one if all do."""
    found = []
    for name in LATCHED_TOPICS:
        topic = node.resolve_topic_name(name)
        offered = node.get_publishers_info_by_topic(topic)
        for info in node.get_subscriptions_info_by_topic(topic):
            if not offered or info.node_name == node.get_name():
                continue
            found.append(_heard(topic, offered[0].qos_profile, info))
    wrong = [check for check in found if check is not None]
    return wrong or [Check("listeners", "ok", "all hear what they subscribe to")]


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

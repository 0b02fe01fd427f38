"""Whether the server is there, and what it says of itself."""

from __future__ import annotations

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from megrasp_core.errors import MegraspError
from megrasp_ros.calling import GraspServerError
from megrasp_ros.recording import server_settings
from megrasp_ros.server.diagnostics import UNREPORTED
from megrasp_ros.server.parameters import Settings

from .asked import Asked
from .check import Check, Level

TWINS = 2.0
"""A second server of the same name is discovered within this time (s) after the first."""
TOLD = 2.0
"""A server that runs tells of itself each second; so long it is listened to (s)."""


def presence(asked: Asked) -> tuple[Check, int]:
    """Whether the server is there, once, and active; and how many of its name there are."""
    asked.until(lambda: _count(asked) > 0)
    asked.until(lambda: _count(asked) > 1, TWINS)
    count, full = _count(asked), asked.full_name
    if count == 0:
        return Check("server", "fail", _absence(asked)), count
    if count > 1:
        text = f"{count} nodes are named {full}; end all but one"
        return Check("server", "fail", text), count
    try:
        state = asked.client.state()
    except GraspServerError as error:
        return Check("server", "fail", f"{full} does not tell its state: {error}"), count
    if state == "active":
        return Check("server", "ok", f"{full} is active"), count
    text = (
        f"{full} is {state}; expected active. Start it with autostart:=true (it takes some "
        "seconds), or let the lifecycle manager configure and activate it; where that fails, "
        "its log and the line `health` say why"
    )
    level: Level = "warn" if state in ("configuring", "activating") else "fail"
    return Check("server", level, text), count


def health(asked: Asked) -> tuple[Check, dict[str, str]]:
    """What the server says of itself in /diagnostics, as a line and as values by their names."""
    status = _status(asked.node, asked.full_name, asked.until)
    if status is None:
        text = f"nothing of {asked.server} on /diagnostics; is it stuck?"
        return Check("health", "warn", text), {}
    levels: dict[bytes, Level] = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
    values = _values(status)
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
    return Check("health", level, text), values


def parameters(asked: Asked) -> tuple[Check, Settings | None]:
    """The server's parameters, None where they cannot be read; its clock has to tick."""
    try:
        settings = server_settings(asked.client)
        simulated = asked.client.parameters(["use_sim_time"]).get("use_sim_time", False)
    except (MegraspError, GraspServerError) as error:
        return Check("parameters", "fail", str(error)), None
    if simulated and not asked.node.get_publishers_info_by_topic("/clock"):
        text = "use_sim_time is true and nobody publishes /clock; start it, or set it to false"
        return Check("clock", "fail", text), settings
    return Check("clock", "ok", "/clock" if simulated else "the machine's"), settings


def cloud_topic(node: Node, server: str) -> str:
    """The topic that the server's `points` is remapped to, "" where no server tells."""
    namespace = node.get_namespace()
    if (server, namespace) not in node.get_node_names_and_namespaces():
        return ""
    end = time.monotonic() + TOLD

    def until(done: Callable[[], bool]) -> None:
        while not done() and time.monotonic() < end:
            time.sleep(0.05)

    status = _status(node, f"{namespace.rstrip('/')}/{server}", until)
    return "" if status is None else _values(status).get("topic points", "")


def _places(asked: Asked) -> list[str]:
    """Namespaces in which there is a node of that name, one that has several more often."""
    nodes = asked.node.get_node_names_and_namespaces()
    return [place for name, place in nodes if name == asked.server]


def _count(asked: Asked) -> int:
    return _places(asked).count(asked.node.get_namespace())


def _absence(asked: Asked) -> str:
    node, places = asked.node, sorted(_places(asked))
    if places:
        return (
            f"no {asked.server} in namespace {node.get_namespace()}, but in {', '.join(places)}; "
            f"give --namespace {places[0]}"
        )
    others = [
        f"{place.rstrip('/')}/{name}"
        for name, place in node.get_node_names_and_namespaces()
        if name != node.get_name()
    ]
    if others:
        return (
            f"no node {asked.server}, but {', '.join(sorted(others)[:5])}; start it: ros2 run "
            "megrasp_ros grasp_server"
        )
    return (
        "no other node is seen at all; start grasp_server in the same ROS_DOMAIN_ID, and on "
        "another machine with ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET on both"
    )


def _status(
    node: Node, full_name: str, until: Callable[[Callable[[], bool]], object]
) -> DiagnosticStatus | None:
    """What a node says of itself in /diagnostics, None when it says nothing.

    until: waits for a condition.
    """
    heard: list[DiagnosticStatus] = []

    def take(message: DiagnosticArray) -> None:
        heard[:] = [status for status in message.status if status.name == full_name] or heard

    node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    until(lambda: bool(heard))
    return heard[-1] if heard else None


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {each.key: each.value for each in status.values}

"""docs/ros.md names everything that the node has."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
import rclpy.action
from cell_processes import own_domain
from megrasp_msgs.msg import ErrorCode
from rclpy.parameter import Parameter
from server_double import make

from megrasp_ros.server.grasp_server import GraspServer
from megrasp_ros.server.names import NAMES
from megrasp_ros.server.parameter_page import TABLES, error_table

PAGE = Path(__file__).parents[3] / "docs" / "ros.md"

OPTIONAL = {"/tf_static", "points", "depth", "camera_info", "mask"}
"""There with tf2_msgs, and while a request waits."""


@pytest.mark.parametrize("mark", TABLES)
def test_the_page_has_the_tables_that_the_command_writes(mark: str) -> None:
    assert f"<!-- {mark} -->\n{TABLES[mark]()}<!-- /{mark} -->" in PAGE.read_text(), (
        "run python -m megrasp_ros.server.parameter_page docs/ros.md"
    )


def test_every_error_code_has_its_line() -> None:
    codes = [name for name in dir(ErrorCode) if name.isupper() and name != "SLOT_TYPES"]
    assert len(codes) > 15
    for name in codes:
        assert f"| {getattr(ErrorCode, name)} | `{name}` |" in error_table()


def test_the_node_has_the_names_of_the_table() -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain(7))
    off = Parameter("autostart", value=False)
    node = GraspServer(factory=make, context=context, parameter_overrides=[off])
    try:
        graph = [
            *node.get_publisher_names_and_types_by_node("grasp_server", "/"),
            *node.get_subscriber_names_and_types_by_node("grasp_server", "/"),
            *node.get_service_names_and_types_by_node("grasp_server", "/"),
            *rclpy.action.get_action_server_names_and_types_by_node(node, "grasp_server", "/"),
        ]
    finally:
        node.close()
        node.destroy_node()
        context.try_shutdown()
    there = {
        name: kinds[0]
        for name, kinds in graph
        if not name.startswith(("/grasp_server/", "/rosout", "/clock", "/parameter_events"))
        and "/_action/" not in name
    }
    named = {f"/{name.lstrip('/')}": about.kind for name, about in NAMES.items()}
    left_out = {f"/{name.lstrip('/')}" for name in OPTIONAL}
    assert {name: kind for name, kind in named.items() if name not in left_out} == {
        name: kind for name, kind in there.items() if name not in left_out
    }

"""docs/ros.md names every parameter."""

from __future__ import annotations

from pathlib import Path

from megrasp_ros.server.parameter_page import MARK, table

PAGE = Path(__file__).parents[3] / "docs" / "ros.md"


def test_the_page_has_the_table_that_the_command_writes() -> None:
    assert f"<!-- {MARK} -->\n{table()}<!-- /{MARK} -->" in PAGE.read_text(), (
        "run python -m megrasp_ros.server.parameter_page docs/ros.md"
    )

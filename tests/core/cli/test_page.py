"""docs/cli.md names every command."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.cli.page import MARK, table

PAGE = Path(__file__).parents[3] / "docs" / "cli.md"


def test_the_page_has_the_table_that_the_command_writes() -> None:
    text = PAGE.read_text()
    assert f"<!-- {MARK} -->\n{table()}<!-- /{MARK} -->" in text, (
        "run python -m megrasp_core.cli.page docs/cli.md"
    )


def test_every_command_says_what_it_does() -> None:
    rows = table().splitlines()[2:]
    assert len(rows) > 20
    assert all(row.split("|")[2].strip() for row in rows)

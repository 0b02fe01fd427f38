"""docs/cli.md names every command, docs/results.md every result file."""

from __future__ import annotations

import re
from pathlib import Path

from megrasp_core.cli import results_page
from megrasp_core.cli.page import MARK, table

PAGE = Path(__file__).parents[3] / "docs" / "cli.md"
RESULTS = PAGE.with_name("results.md")
RATE = re.compile(r"\d+/\d+ = [\d.]+ % \[[\d.]+, [\d.]+\]")


def test_the_page_has_the_table_that_the_command_writes() -> None:
    text = PAGE.read_text()
    assert f"<!-- {MARK} -->\n{table()}<!-- /{MARK} -->" in text, (
        "run python -m megrasp_core.cli.page docs/cli.md"
    )


def test_every_command_says_what_it_does() -> None:
    rows = table().splitlines()[2:]
    assert len(rows) > 20
    assert all(row.split("|")[2].strip() for row in rows)


def test_the_rates_are_those_of_the_result_files() -> None:
    page = RESULTS.read_text()
    for name, text in results_page.BLOCKS.items():
        assert f"<!-- {name} -->\n{text(RESULTS)}<!-- /{name} -->" in page, (
            "run python -m megrasp_core.cli.results_page docs/results.md"
        )
    made = results_page.tables(RESULTS)
    assert "[robotiq_2f85](results/megrasp_small/binpick_robotiq_2f85_50.json)" in made
    assert "297/420 = 70.7 % [66.2, 74.9]" in made


def test_the_readme_states_the_rates_of_its_result_files() -> None:
    """Its tables are a choice of rows and columns, with other words around the same numbers."""
    readme = (PAGE.parents[1] / "README.md").read_text().replace("*", "")
    made = "".join(text(RESULTS) for text in results_page.BLOCKS.values())
    stated = set(RATE.findall(readme))
    assert len(stated) > 15
    assert stated <= set(RATE.findall(made))
    shown = [
        line
        for line in results_page.tables(RESULTS).splitlines()
        if "/evaluation/binpick_" in line
    ]
    assert shown
    for line in shown:
        assert line.split(" | ")[4] in stated, f"the first grasps of {line}"

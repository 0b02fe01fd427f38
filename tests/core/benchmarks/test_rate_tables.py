"""Tables of the data generator's rates, and that the page shows those of the file beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from megrasp_core.benchmarks.rate_tables import rate_tables
from megrasp_core.benchmarks.trial_profile import STAGES
from megrasp_core.cli.bench import bench
from megrasp_core.errors import InvalidRequestError

DOCS = Path(__file__).parents[3] / "docs"

ROW = {
    "gripper": "claw",
    "timestep": 0.004,
    "full_trials_per_second": 38.77,
    "plain_full_trials_per_second": 24.3,
    "cad_full_trials_per_second": None,
    "yield": 0.774,
    "yield_at_tcp": 0.5,
    "agrees_with_plain": 0.995,
    "plain_agrees_with_itself_moved": 1.0,
    "collision_tests_per_second": 21242.4,
    "profile": {
        "shares": {**dict.fromkeys(STAGES, 0.1), "around": 0.4},
        "contacts": 6.32,
        "iterations": 1.28,
    },
}


def test_a_row_says_what_was_measured():
    text = rate_tables({"reference_timestep": 0.002, "rows": [ROW, {**ROW, "profile": {}}]})
    lines = text.splitlines()
    rates = "| claw | 4 ms | 38.8 | 24.3 | - | 77% | 50% | 99.5% | 100.0% | 21,242 |"
    assert lines.count(rates) == 2
    assert lines.count(f"| claw {'| 10% ' * len(STAGES)}| 40% | 6.3 | 1.3 |") == 1
    for line in lines:
        assert not line.startswith("|") or line.count("|") in (11, len(STAGES) + 5)


def test_the_page_shows_the_committed_measurement():
    content = json.loads((DOCS / "results" / "data_bench.json").read_text())
    page = (DOCS / "data.md").read_text()
    assert f"<!-- rates -->\n{rate_tables(content)}<!-- /rates -->" in page


def test_a_page_is_for_the_rates_of_the_data_generator_alone(tmp_path):
    with pytest.raises(InvalidRequestError, match="--stage render; expected --stage data"):
        bench(stage="render", page=tmp_path / "page.md")
    (tmp_path / "page.md").write_text("no marks\n")
    with pytest.raises(InvalidRequestError, match="<!-- rates -->"):
        bench(stage="data", page=tmp_path / "page.md")

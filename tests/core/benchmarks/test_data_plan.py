"""Core-hours follow from the rates given."""

from __future__ import annotations

import json

import pytest

from megrasp_core.benchmarks.data_plan import plan_data, plan_table
from megrasp_core.cli.data.plan import plan
from megrasp_core.errors import DataError, InvalidRequestError

RATES = {
    "rows": [
        {  # three of four trials hold: two trials a success all the same, for the failures
            "gripper": "jaw",
            "full_trials": 80,
            "drawn": 100,
            "yield": 0.6,
            "full_trials_per_second": 20.0,
            "collision_tests_per_second": 250.0,
        },
        {  # one of four holds
            "gripper": "hand",
            "full_trials": 40,
            "drawn": 100,
            "yield": 0.1,
            "full_trials_per_second": 10.0,
            "collision_tests_per_second": 100.0,
        },
    ],
    "hardware": {"cpu": "a test"},
}


def test_the_cost_of_a_success_is_trials_and_collision_tests():
    found = plan_data(RATES, 9.0, objects=10, grippers=4, successes=90, scenes=800, cores=(2, 8))
    assert found["seconds_a_success"] == {
        "jaw": pytest.approx(2 / 20 + 2.5 / 250),
        "hand": pytest.approx(4 / 10 + 10 / 100),
    }
    mean = (0.11 + 0.5) / 2
    assert found["library_core_hours"] == pytest.approx(10 * 4 * 90 * mean / 3600)
    assert found["scene_core_hours"] == pytest.approx(2.0)
    assert [row["scenes"] for row in found["hours"]] == pytest.approx([1.0, 0.25])
    table = plan_table(found)
    assert "| core-hours | 0 | 2 |" in table and "| 8 | 2 min | 15 min |" in table


def test_the_command_reads_what_the_other_commands_write(tmp_path, capsys):
    rates, stats, out = tmp_path / "rates.json", tmp_path / "stats.json", tmp_path / "plan.json"
    rates.write_text(json.dumps(RATES))
    runs = [{"done": 3, "cpu_seconds": 30.0}, {"done": 1, "cpu_seconds": 2.0}]
    stats.write_text(json.dumps({"scenes": 4, "runs": runs}))
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- plan -->\nold\n<!-- /plan -->\nafter\n")
    assert plan(rates, stats, cores=(16,), out=out, page=page) == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- plan -->\n| cores |") and "old" not in text
    assert "| 16 |" in text and text.endswith("<!-- /plan -->\nafter\n")
    assert json.loads(out.read_text())["scene_seconds"] == 8.0
    assert "| 16 |" in capsys.readouterr().out
    with pytest.raises(InvalidRequestError, match="at least 1"):
        plan(rates, stats, cores=(0,))
    with pytest.raises(DataError, match="no rates"):
        plan(stats, stats)
    stats.write_text(json.dumps({"scenes": 4, "runs": []}))
    with pytest.raises(DataError, match="how long"):
        plan(rates, stats)

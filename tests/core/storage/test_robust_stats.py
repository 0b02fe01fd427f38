"""Counts of robust labels, and the page that tells them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dataset_records import labels

from megrasp_core.storage import NOT_TRIED, GripperLabels, Kind
from megrasp_core.storage.robust_stats import held_counts, joined_counts, robust_stats

DOCS = Path(__file__).parents[3] / "docs"
FACTORS = ("pose", "friction", "mass", "force")


def known(label: list[int], kind: list[Kind], robust: list[int]) -> GripperLabels:
    made = labels(np.random.default_rng(0), len(label), 3)
    return replace(
        made,
        label=np.array(label, np.int8),
        kind=np.array(kind, np.int8),
        robust=np.array(robust, np.int8),
    )


def test_counts_tell_kind_and_plain_label():
    some = known(
        [1, 1, 0, 0, 1],
        [Kind.JUDGED, Kind.JUDGED, Kind.JUDGED, Kind.PERTURBED, Kind.PERTURBED],
        [4, 1, 2, 0, NOT_TRIED],
    )
    assert held_counts(some) == {
        "judged_success": [0, 1, 0, 0, 1],
        "judged_failure": [0, 0, 1, 0, 0],
        "perturbed_failure": [1, 0, 0, 0, 0],
    }
    assert held_counts(GripperLabels.empty()) == {}
    twice = joined_counts([held_counts(some), {}, held_counts(some)])
    assert twice["judged_success"] == [0, 2, 0, 0, 2] and list(twice) == sorted(twice)


def test_what_runs_took_is_added_up():
    held = {"a": {"judged_success": [0, 0, 0, 1, 1]}, "b": {"judged_failure": [1, 0, 0, 0, 0]}}
    took = {"grasps": 1, "trials": 4, "cpu_seconds": 0.5, "failed": {"slipped": 1}}
    runs = [{"robust": {"a": took, "b": took}}, {"robust": {"a": took}}, {"done": 3}]
    stats = robust_stats({**held, "c": {}}, runs)
    assert list(stats) == ["all", "a", "b"]
    assert stats["a"]["success_held"] == 7 / 8 and stats["b"]["success_held"] is None
    assert stats["a"]["cpu_seconds_a_grasp"] == 0.5 and stats["a"]["trials"] == 8
    assert stats["all"]["grasps"] == 3 and stats["all"]["failed"] == {"slipped": 3}
    assert "trials" not in robust_stats(held, [])["a"]
    assert robust_stats({"c": {}}, runs) == {}


def test_the_page_tells_what_the_files_hold():
    page = (DOCS / "data.md").read_text().partition("## Robust labels")[2].partition("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    table = {row[0]: row[1:] for row in rows if len(row) == 13}
    whole, *alone = (
        json.loads((DOCS / "results" / f"robust_labels{end}.json").read_text())["robust"]
        for end in ("", *(f"_{factor}" for factor in FACTORS))
    )
    assert set(whole) <= set(table) and len(whole) == 12
    for name, told in whole.items():
        parts = [np.array(c) for kind, c in told["held"].items() if kind.endswith("_success")]
        counts = sum(parts[1:], parts[0])
        cells = [float(cell.rstrip("%")) for cell in table[name]]
        assert cells[0] == counts.sum()
        assert cells[1:6] == pytest.approx(100 * counts[::-1] / counts.sum(), abs=0.51)
        shares = [told["success_held"], *(one[name]["success_held"] for one in alone)]
        assert cells[6:11] == pytest.approx([100 * share for share in shares], abs=0.51)
        assert cells[11] == pytest.approx(told["cpu_seconds_a_grasp"], abs=0.0051)

"""Counts of a grasp library, checked by hand, and the card that tells them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from made_library import made_library, made_set

from megrasp_core.library import (
    GraspLibrary,
    ObjectFacts,
    library_card,
    library_stats,
    load_library,
    object_facts,
)
from megrasp_core.objects import ObjectSet, asset_names

LIBRARY = Path(__file__).parents[3] / "models" / "grasp_library"
CUP = ObjectFacts("asset/train/nowhere/cup", "nowhere", (0.04, 0.05, 0.09), 0.12, "CC BY 4.0")
CAN = ObjectFacts("asset/train/nowhere/can", "nowhere", (0.06, 0.06, 0.10), 0.30, "CC BY 4.0")


def test_counts_of_a_library():
    stats = library_stats(made_library())
    assert json.loads(json.dumps(stats)) == stats
    franka, robotiq = stats["grippers"]["franka_hand"], stats["grippers"]["robotiq_2f85"]
    assert franka.pop("mean_quality") == pytest.approx(0.3)
    assert franka == {
        "objects": 3,
        "objects_with_success": 2,
        "objects_complete": 1,
        "successes": 104,
        "failures_kept": 103,
        "trials": 225,
        "drawn": 442,
        "start_collisions": 217,
        "yield": 104 / 442,
        "held_of_trials": 104 / 225,
        "failure_to_success": 0.0,
        "success_to_success": 0.0,
        "failures_by_reason": {"slipped": 102, "no_contact": 1},
        "hashes": ["hash of franka_hand"],
    }
    assert robotiq["objects_with_success"] == 1 and robotiq["objects_complete"] == 0
    assert robotiq["failure_to_success"] is None
    assert robotiq["yield"] == 2 / 13 and robotiq["held_of_trials"] == 1.0
    total = {key: stats[key] for key in ("pairs", "pairs_with_success", "pairs_complete")}
    assert total == {"pairs": 5, "pairs_with_success": 3, "pairs_complete": 1}
    assert (stats["objects"], stats["objects_of_all_grippers"]) == (3, 2)
    assert stats["sources"] == {"nowhere": 1, "procedural": 2}
    assert (stats["successes"], stats["failures_kept"], stats["drawn"]) == (106, 103, 455)
    assert (stats["trials"], stats["start_collisions"]) == (227, 228)
    assert stats["grippers_able"] == {
        "asset/train/nowhere/cup": {"able": 1, "labelled": 2},
        "procedural/000000": {"able": 2, "labelled": 2},
        "procedural/000003": {"able": 0, "labelled": 1},
    }


def test_how_far_failures_lie_from_successes():
    """Successes at 0, 1 and 3 cm, failures at 5 and 7 cm; other pairs do not mix."""
    near = made_set("franka_hand", "procedural/000000", 3, ("slipped", "slipped"), 9, 5)
    near.object_from_tcp[:, 0] = [0.0, 0.01, 0.03, 0.05, 0.07]
    alone = made_set("franka_hand", "procedural/000003", 1, (), 9, 1)
    franka = library_stats(GraspLibrary([near, alone]))["grippers"]["franka_hand"]
    assert franka["failure_to_success"] == pytest.approx(0.03)
    assert franka["success_to_success"] == pytest.approx(0.01)


def assert_alike(written: Any, found: Any) -> None:
    """Equal but for the last digits of means and medians, which are others on other processors."""
    if isinstance(found, dict):
        assert written.keys() == found.keys()
        for key, value in found.items():
            assert_alike(written[key], value)
    elif isinstance(found, float):
        assert written == pytest.approx(found, rel=1e-9)
    else:
        assert written == found


def test_the_committed_card_and_its_figures_are_those_of_the_committed_library():
    """Sizes and terms aside, which need the outside objects."""
    written = json.loads((LIBRARY / "stats.json").read_text())
    found = json.loads(json.dumps(library_stats(load_library(LIBRARY))))
    for key in set(found) - {"sizes", "terms"}:
        assert_alike(written[key], found[key])
    card = (LIBRARY / "README.md").read_text()
    command = card.partition("how it was packed:\n\n```\n")[2].partition("\n")[0]
    assert card == library_card(written, command)


def test_an_empty_library_has_no_rates():
    stats = library_stats(GraspLibrary())
    assert stats["pairs"] == stats["objects"] == stats["objects_of_all_grippers"] == 0
    assert stats["grippers"] == {} and stats["sizes"] == {"objects": 0}


def test_sizes_and_terms_of_the_objects():
    stats = library_stats(made_library(), [CUP, CAN])
    assert stats["sizes"] == {
        "objects": 2,
        "smallest_extent": {"min": 0.04, "median": 0.05, "max": 0.06},
        "largest_extent": {"min": 0.09, "median": pytest.approx(0.095), "max": 0.10},
        "mass": {"min": 0.12, "median": pytest.approx(0.21), "max": 0.30},
    }
    assert stats["terms"] == {"nowhere": ["CC BY 4.0"]}


def test_objects_that_cannot_be_loaded_are_named(monkeypatch):
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    names = ["procedural/000001", "asset/train/ycb/cup", "nonsense"]
    seen = []
    facts, missing = object_facts(names, on_progress=lambda: seen.append(1))
    assert missing == names[1:] and len(seen) == 3
    model = ObjectSet(())["procedural/000001"]
    assert [fact.name for fact in facts] == names[:1]
    assert facts[0].extents == tuple(sorted(model.extents)) and facts[0].mass == model.mass
    assert facts[0].source == "procedural" and "Apache-2.0" in facts[0].terms


def test_terms_of_scans_come_from_their_folders(assets):
    name = next(name for name in asset_names("train") if "/ycb/" in name)
    facts, missing = object_facts([name])
    assert not missing and facts[0].source == "ycb" and "CC BY 4.0" in facts[0].terms


def test_the_card_tells_the_counts():
    card = library_card(library_stats(made_library(), [CUP]))
    assert "106 that hold and 103 that do not, of 2 grippers on 3 objects." in card
    assert "Of 5 pairs of gripper and object, 3 have a success and 1 have" in card
    row = next(line for line in card.splitlines() if line.startswith("| franka_hand"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1:] == [
        "3", "2", "1", "104", "103", "442", "24%", "46%", "0.30", "0 mm", "0 mm",
        "`hash of fran`",
    ]  # fmt: skip
    assert "| nowhere | 1 | CC BY 4.0 |" in card and "meshes are not included" in card
    assert "| procedural | 2 | Apache-2.0" in card
    assert "228 collided at the start, 227 went through the full trial" in card
    assert "smallest edge of the\nbox around it 40, 40, 40 mm" in card
    assert "--gripper franka_hand robotiq_2f85 --procedural 4\n" in card
    assert "Free-space labels only" in card
    assert "megrasp_core 0." in card and "MuJoCo " in card


def test_the_card_has_the_command_that_is_given():
    stats = library_stats(made_library())
    card = library_card(stats, "megrasp data grasps --out here --target 7")
    assert "megrasp data grasps --out here --target 7\n" in card
    assert "--procedural 4" not in card and "could be loaded" not in card


def test_the_card_tells_what_the_logged_runs_took():
    run = {"done": 30, "cpu_seconds": 5400.0, "cpu": "a chip", "seed": 3, "versions": {"x": "1"}}
    untimed = {**run, "done": 12, "cpu_seconds": None, "cpu": "another"}
    stats = library_stats(made_library(), [CUP])
    card = library_card({**stats, "runs": [run, untimed]})
    assert "labelled 42 pairs" in card
    assert "30 of them in 1.5 CPU-hours (a chip).\nSeed 3, x 1." in card
    card = library_card({**stats, "runs": [untimed]})
    assert "labelled 12 pairs" in card and "CPU-hours" not in card

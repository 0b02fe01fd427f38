"""`megrasp data stats` of a library: counts, pictures, card."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from made_library import made_library

from megrasp_core.cli import main
from megrasp_core.library import pack_library, write_grasp_set


def run(capsys, *args: object) -> tuple[int, str, str]:
    code = main([str(a) for a in ("data", "stats", *args)])
    told = capsys.readouterr()
    return code, told.out, told.err


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A library of one file a pair."""
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    for entry in made_library():
        write_grasp_set(tmp_path / "library", entry)
    return tmp_path / "library"


def test_counts_are_the_same_of_a_folder_and_packed(capsys, folder, tmp_path):
    pack_library(made_library(), tmp_path / "packed")
    code, said, _ = run(capsys, "--out", folder)
    stats = json.loads(said)
    assert code == 0 and stats["successes"] == 106 and stats["sizes"]["objects"] == 2
    assert json.loads(run(capsys, "--out", tmp_path / "packed")[1]) == stats


def test_pictures_and_card(capsys, folder, tmp_path):
    card = tmp_path / "new" / "README.md"
    code, said, _ = run(
        capsys, "--out", folder, "--pictures", tmp_path / "p", "--card", card,
        "--command", "megrasp data grasps --out here",
    )  # fmt: skip
    names = ["grasps.png", "grippers_per_object.png", "objects.png", "yield.png"]
    assert code == 0 and sorted(file.name for file in (tmp_path / "p").iterdir()) == names
    assert json.loads((card.parent / "stats.json").read_text())["pairs"] == 5
    assert "note: 1 objects could not be loaded" in said and f"wrote {card}" in said
    assert "106 that hold" in card.read_text() and "--out here" in card.read_text()


def test_a_card_is_of_a_library(capsys, folder, tmp_path):
    code, _, told = run(capsys, "--out", folder, "--command", "megrasp data grasps")
    assert code == 2 and "without --card" in told
    (tmp_path / "manifest.json").write_text("{}")
    code, _, told = run(capsys, "--out", tmp_path, "--card", tmp_path / "card.md")
    assert code == 2 and "expected a grasp library" in told


def test_recipes_are_counted_together(capsys, tmp_path):
    recipes = Path(__file__).parents[3] / "models" / "scene_recipes" / "three_grippers_20000.npz"
    code, said, _ = run(capsys, "--data", recipes, recipes)
    stats = json.loads(said)
    assert code == 0 and stats["scenes"] == 46 and stats["mean_points"] == 0
    won = sum(
        count
        for one in stats["grippers"].values()
        for kind, count in one["labels"].items()
        if kind.endswith("success")
    )
    assert won == sum(one["successes"] for one in stats["objects"].values()) == 2 * 815
    code, _, told = run(capsys, "--data", recipes, tmp_path)
    assert code == 2 and "one or the other" in told

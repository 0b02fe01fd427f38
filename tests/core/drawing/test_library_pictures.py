"""Pictures of a grasp library: that they are there, are small, and show what they should."""

from __future__ import annotations

import numpy as np
import pytest
from made_library import made_library, made_set
from PIL import Image

from megrasp_core.drawing.contact_sheet import FAILURE, SUCCESS
from megrasp_core.drawing.data_charts import draw_scene_stats
from megrasp_core.drawing.frame_raster import OPEN
from megrasp_core.drawing.library_pictures import (
    TILE,
    draw_grasp,
    grasp_sheet,
    library_pictures,
    random_grasps,
)
from megrasp_core.grippers import load_gripper
from megrasp_core.library import GraspLibrary, library_stats, object_facts
from megrasp_core.objects import ObjectSet

LIMIT = 150_000


@pytest.fixture(autouse=True)
def no_assets(monkeypatch):
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)


def shades(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(image.astype(int) - colour).max(axis=-1) < 12).sum())


def test_all_pictures_are_drawn_and_small(tmp_path):
    library = made_library()
    facts, missing = object_facts({entry.object_name for entry in library})
    stats = library_stats(library, facts)
    pictures, notes = library_pictures(library, stats, facts, missing, tmp_path / "p")
    sizes = {}
    for file in pictures:
        assert 2000 < file.stat().st_size < LIMIT
        with Image.open(file) as image:
            sizes[file.name] = image.size
    assert sizes["yield.png"] == (800, 244) and sizes["objects.png"] == (1000, 360)
    assert sizes["grippers_per_object.png"] == (800, 380) and "grasps.png" in sizes
    assert len(notes) == 1 and "1 objects could not be loaded" in notes[0]
    assert "asset/train/nowhere/cup" in notes[0]


def test_pictures_of_nothing_that_can_be_loaded(tmp_path):
    library = GraspLibrary([made_set("no_such_gripper", "asset/train/x/cup", 2, (), 4, 2)])
    stats = library_stats(library)
    pictures, notes = library_pictures(library, stats, [], ["asset/train/x/cup"], tmp_path)
    assert [p.name for p in pictures] == ["yield.png", "grippers_per_object.png", "objects.png"]
    assert any("no_such_gripper cannot be loaded" in note for note in notes)
    assert notes[-1] == "no grasp could be drawn"


def test_the_sheet_frames_successes_green_and_failures_red(tmp_path):
    held = GraspLibrary([made_set("franka_hand", "procedural/000000", 3, (), 3, 3)])
    lost = GraspLibrary([made_set("franka_hand", "procedural/000000", 0, ("slipped",), 1, 1)])
    for library, shown, other in ((held, SUCCESS, FAILURE), (lost, FAILURE, SUCCESS)):
        path, notes = grasp_sheet(library, tmp_path / "sheet.png")
        assert path is not None and notes == []
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"))
        assert pixels.shape[1] == pytest.approx(TILE[0], abs=20)
        assert shades(pixels, shown) > 1500 and shades(pixels, other) < 100
    same = grasp_sheet(lost, tmp_path / "again.png")[0]
    assert same is not None and same.read_bytes() == (tmp_path / "sheet.png").read_bytes()


def test_grippers_take_turns_and_objects_differ():
    grippers = {name: load_gripper(name) for name in ("franka_hand", "robotiq_2f85")}
    library = GraspLibrary(
        made_set(gripper, f"procedural/{number:06d}", 3, ("slipped",), 9, 4)
        for gripper in grippers
        for number in range(4)
    )
    rng = np.random.default_rng(0)
    for success in (True, False):
        found = random_grasps(library, grippers, ObjectSet(()), success, 4, rng)
        assert (
            sorted(entry.gripper for entry, _ in found)
            == ["franka_hand"] * 2 + ["robotiq_2f85"] * 2
        )
        assert len({entry.object_name for entry, _ in found}) == 4
        assert all(entry.success[index] == success for entry, index in found)
    everything = random_grasps(library, grippers, ObjectSet(()), True, 99, rng)
    assert len(everything) == len(library)


def test_a_grasp_shows_gripper_above_the_object_at_its_pose():
    gripper = load_gripper("franka_hand")
    model = ObjectSet(())["procedural/000000"]
    model = type(model)(**{**vars(model), "colour": (1.0, 0.0, 0.0)})
    pose = np.eye(4)
    pose[2, 3] = -0.08
    image = draw_grasp(gripper, model, pose)
    assert image.shape == (TILE[1], TILE[0], 3)
    red = (image[..., 0] - image[..., 1]) > 0.2
    # The gripper's colour has more blue than red at any brightness.
    blue = (image[..., 2] / np.maximum(image[..., 0], 1e-3)) > 0.9 * OPEN[2] / OPEN[0]
    assert red.sum() > 300 and blue.sum() > 2000
    assert np.nonzero(red)[0].mean() > np.nonzero(blue)[0].mean() + 30
    # Turned about, the object lies behind the gripper's flange, above it in the picture.
    pose[2, 3] = 0.25
    red = np.subtract(*np.moveaxis(draw_grasp(gripper, model, pose), -1, 0)[:2]) > 0.2
    assert red.any() and np.nonzero(red)[0].mean() < TILE[1] / 3


def test_chart_of_scenes(tmp_path):
    stats = {
        "scenes": 3,
        "mean_objects": 2.0,
        "grippers": {
            "franka_hand": {"successes_per_scene": 4.0, "judged_failures": {"slipped": 2}},
            "robotiq_3f": {"successes_per_scene": 0.0, "judged_failures": {}},
        },
    }
    file = draw_scene_stats(stats, tmp_path / "new" / "scenes.png")
    with Image.open(file) as image:
        assert image.size == (1000, 244)
    assert file.stat().st_size < LIMIT

"""The grasp library and scene recipes as files: rounding, size limit, damage."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from dataset_records import record
from made_library import made_set

from megrasp_core.errors import DataError, ObjectError
from megrasp_core.jobs import RunSummary
from megrasp_core.library import (
    GraspLibrary,
    LabelSettings,
    LibraryConfig,
    generate_library,
    labelling,
    load_library,
    pack_library,
    write_grasp_set,
)
from megrasp_core.library.grasp_library import with_few_failures
from megrasp_core.objects import ObjectSet, balanced_shares, procedural_names
from megrasp_core.objects.object_set import SIZE_EDGES
from megrasp_core.scenes import read_recipes, write_recipes
from megrasp_core.storage import GraspSet, Kind

MODELS = Path(__file__).parents[3] / "models"


def grasp_set(gripper: str, name: str, count: int, seed: int) -> GraspSet:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(count, 7))
    pose[:, :3] = rng.uniform(-0.3, 0.3, size=(count, 3))
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    success = rng.random(count) < 0.6
    reason = np.where(success, "", rng.choice(["slipped", "no_contact"], count))
    quality = np.where(success, rng.random(count), 0.0).astype(np.float32)
    return GraspSet(gripper, "hash", name, pose, success, quality, reason, 3 * count, count)


def assert_close(first: GraspSet, second: GraspSet) -> None:
    for name in ("gripper", "gripper_hash", "object_name", "drawn", "tried"):
        assert getattr(first, name) == getattr(second, name)
    np.testing.assert_array_equal(first.success, second.success)
    np.testing.assert_array_equal(first.reason, second.reason)
    np.testing.assert_allclose(first.quality, second.quality, atol=0.51 / 255)
    np.testing.assert_allclose(
        first.object_from_tcp[:, :3], second.object_from_tcp[:, :3], atol=0.6e-5
    )
    cosine = np.abs((first.object_from_tcp[:, 3:] * second.object_from_tcp[:, 3:]).sum(1))
    assert (2 * np.arccos(np.minimum(cosine, 1)) < np.deg2rad(0.01)).all()


def test_a_library_comes_back_from_its_folder_and_packed(tmp_path):
    sets = [
        grasp_set("jaw", "asset/train/ycb/cup", 30, 0),
        grasp_set("jaw", "procedural/000001", 0, 1),
        grasp_set("claw", "asset/train/ycb/cup", 12, 2),
    ]
    for entry in sets:
        write_grasp_set(tmp_path / "work", entry)
    size = pack_library(load_library(tmp_path / "work"), tmp_path / "packed")
    files = sorted((tmp_path / "packed").iterdir())
    assert [file.name for file in files] == ["claw.npz", "jaw.npz"]
    assert size == sum(file.stat().st_size for file in files)
    for source in (tmp_path / "work", tmp_path / "packed"):
        library = load_library(source)
        assert len(library) == 3
        for entry in sets:
            found = library.get(entry.gripper, entry.object_name)
            assert found is not None
            assert_close(entry, found)
        assert library.objects() == ["asset/train/ycb/cup"]
        assert library.objects(["jaw"]) == ["asset/train/ycb/cup", "procedural/000001"]
    assert library.get("claw", "procedural/000001") is None


def test_the_size_limit_is_kept(tmp_path):
    library = GraspLibrary([grasp_set("jaw", "a", 500, 0)])
    with pytest.raises(DataError, match="expected at most 1000"):
        pack_library(library, tmp_path / "packed", limit=1000)
    assert not (tmp_path / "packed").exists()
    # 17 bytes a grasp before compression: what is committed stays small.
    assert pack_library(library, tmp_path / "packed") < 500 * 17 + 2000


def test_thinning_keeps_successes_and_some_failures():
    entry = grasp_set("jaw", "a", 100, 4)
    thin = with_few_failures(entry, 5)
    assert thin.success.sum() == entry.success.sum()
    assert (~thin.success).sum() == 5
    np.testing.assert_array_equal(thin.successes, entry.successes)


def test_wrong_files_are_named(tmp_path):
    with pytest.raises(DataError, match=r"no \.npz; expected a grasp library"):
        load_library(tmp_path)
    with pytest.raises(DataError, match="no file"):
        load_library(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    with pytest.raises(DataError, match="is no grasp library"):
        load_library(tmp_path / "other.npz")
    with pytest.raises(DataError, match="no scene recipes"):
        read_recipes(tmp_path / "other.npz")


def test_far_grasps_are_refused_not_wrapped(tmp_path):
    entry = grasp_set("jaw", "a", 3, 0)
    entry.object_from_tcp[1, 0] = 0.5
    with pytest.raises(DataError, match=r"0\.328 m"):
        pack_library(GraspLibrary([entry]), tmp_path / "packed")
    assert not (tmp_path / "packed").exists()


def test_recipes_keep_object_poses_exactly_and_grasps_within_rounding(tmp_path):
    records = [record(seed, in_bin=seed != 2) for seed in range(6)]
    size = write_recipes(tmp_path / "recipes.npz", records)
    assert size < 6 * 1500
    found = read_recipes(tmp_path / "recipes.npz")
    assert len(found) == 6
    for a, b in zip(records, found):
        assert (a.name, a.seed, a.object_names, a.bin) == (
            b.name,
            b.seed,
            b.object_names,
            b.bin,
        )
        assert a.object_poses.tobytes() == b.object_poses.tobytes()
        np.testing.assert_array_equal(a.obstacle, b.obstacle)
        assert sorted(a.labels) == sorted(b.labels)
        for gripper, first in a.labels.items():
            second = b.labels[gripper]
            for name in ("object", "label", "kind", "reason", "extra", "robust"):
                np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
            np.testing.assert_allclose(first.world_from_tcp, second.world_from_tcp, atol=3e-5)


def test_pairs_that_got_less_work_than_wanted_are_made_anew(tmp_path, monkeypatch):
    """A library made with less effort is completed by the same command with more."""
    wanted: list[tuple[str, str]] = []

    def keep_units(_, units, *args, **kwargs) -> RunSummary:
        del args, kwargs
        wanted.extend(units)
        return RunSummary()

    monkeypatch.setattr(labelling, "run_units", keep_units)
    names = procedural_names(5)
    enough = ("slipped",) * 4
    sets = [
        made_set("franka_hand", names[0], 4, enough, 30, 8),
        made_set("franka_hand", names[1], 4, enough[:3], 30, 7),
        made_set("franka_hand", names[2], 4, enough[:3], 30, 20),  # no more than that is tried
        made_set("franka_hand", names[3], 0, enough[:1], 30, 5),  # nothing to go on from
    ]
    for entry in sets:
        write_grasp_set(tmp_path, entry)
    settings = LabelSettings(target=4, trials=20)
    generate_library(tmp_path, LibraryConfig(("franka_hand",), ObjectSet(names), 0, settings))
    assert sorted(wanted) == [("franka_hand", names[1]), ("franka_hand", names[4])]


def test_object_names_bring_models_back_and_wrong_ones_are_named(monkeypatch):
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    objects = ObjectSet(procedural_names(2))
    assert objects["procedural/000001"] is objects["procedural/000001"]
    assert objects["obstacle/000004"].extents.max() > objects["procedural/000001"].extents.max()
    with pytest.raises(ObjectError, match="unknown object 'cup'; expected"):
        objects["cup"]
    with pytest.raises(ObjectError, match="MEGRASP_ASSETS"):
        objects["asset/train/ycb/cup"]


def test_objects_are_drawn_evenly_over_sizes_and_categories():
    objects = ObjectSet(procedural_names(30))
    shares = balanced_shares(objects)
    edge = np.array([np.ptp(objects[name].vertices, axis=0).max() for name in objects.names])
    kind = np.array([objects[name].category for name in objects.names])
    size = np.digitize(edge, SIZE_EDGES)
    by_size = [shares[size == one].sum() for one in np.unique(size)]
    np.testing.assert_allclose(by_size, 1 / len(by_size))
    kinds, count = np.unique(kind[size == 1], return_counts=True)
    middle = np.array([shares[(size == 1) & (kind == one)].sum() for one in kinds])
    assert count.max() > count.min()
    np.testing.assert_allclose(middle / middle[0], np.sqrt(count / count[0]))
    assert balanced_shares(objects) is shares


def test_the_models_page_tells_what_the_committed_recipes_hold():
    page = (MODELS / "README.md").read_text()
    found = {}
    for path in (MODELS / "scene_recipes").glob("*.npz"):
        records = read_recipes(path)
        labels = [entry for record in records for entry in record.labels.values()]
        held = np.concatenate([entry.kind[entry.label == 1] for entry in labels])
        untried = int((held == Kind.LIBRARY).sum())
        found[path.name] = (len(records), records[0].seed, f"{untried} of {len(held)}")
    rows = re.findall(r"\| `(\w+\.npz)` \| (\d+) \| (\d+) \|.*\| (\d+ of \d+) \|", page)
    assert {name: (int(count), int(seed), held) for name, count, seed, held in rows} == found

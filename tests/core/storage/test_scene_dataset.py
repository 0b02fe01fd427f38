"""Shards: round trips, resuming, reading while it grows, damaged files, and what verify finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dataset_records import assert_equal, record

from megrasp_core.errors import DataError
from megrasp_core.scenes import read_recipes, write_recipes
from megrasp_core.storage import (
    NOT_TRIED,
    GripperLabels,
    Kind,
    SceneDataset,
    SceneWriter,
    record_problems,
    scene_stats,
    verify_dataset,
)
from megrasp_core.storage.scene_dataset import record_arrays, record_from_arrays

MANIFEST = {"config": {"judged": 8}, "grippers": {"first": "a", "second": "b", "third": "c"}}


def test_records_come_back_bit_for_bit_from_loose_files_and_shards(tmp_path):
    writer = SceneWriter(tmp_path, MANIFEST, shard_size=3)
    written = [record(seed, in_bin=seed % 2 == 0) for seed in range(5)]
    for one in written:
        writer.add(one)
    writer.close()
    assert len(list((tmp_path / "shards").glob("*.npz"))) == 1
    assert len(list((tmp_path / "scenes").glob("*.npz"))) == 2
    dataset = SceneDataset(tmp_path)
    assert len(dataset) == 5 and len(list(dataset)) == 5
    for expected, found in zip(written, dataset):
        assert_equal(expected, found)
    assert dataset.manifests[0]["counts"] == {"scenes": 5}


def test_a_data_set_opened_before_its_scenes_move_into_a_shard_stays_readable(tmp_path):
    writer = SceneWriter(tmp_path, MANIFEST, shard_size=3)
    writer.add(record(0))
    writer.add(record(1))
    dataset = SceneDataset(tmp_path)
    writer.add(record(2))
    assert not list((tmp_path / "scenes").glob("*.npz"))
    assert_equal(dataset[1], record(1))
    assert_equal(dataset[0], record(0))


def test_a_writer_continues_what_it_finds(tmp_path):
    first = SceneWriter(tmp_path, MANIFEST, shard_size=2)
    for seed in (4, 7, 9):
        first.add(record(seed))
    with pytest.raises(DataError, match=r"another run is writing to .*--out"):
        SceneWriter(tmp_path, MANIFEST, shard_size=2)
    first.close()
    second = SceneWriter(tmp_path, MANIFEST, shard_size=2)
    assert [seed in second for seed in (4, 5, 7, 9)] == [True, False, True, True]
    second.add(record(5))
    assert len(second) == 4
    assert [r.seed for r in SceneDataset(tmp_path)] == [4, 5, 7, 9]


def test_a_kill_between_shard_and_removal_counts_no_scene_twice(tmp_path):
    writer = SceneWriter(tmp_path, MANIFEST, shard_size=2)
    writer.add(record(0))
    copy = (tmp_path / "scenes" / "scene_0000000000.npz").read_bytes()
    writer.add(record(1))
    (tmp_path / "scenes" / "scene_0000000000.npz").write_bytes(copy)
    assert SceneDataset(tmp_path).names == ["scene_0000000000", "scene_0000000001"]
    writer.close()
    SceneWriter(tmp_path, MANIFEST, shard_size=2).add(record(2))
    assert [file.stem for file in (tmp_path / "scenes").iterdir()] == ["scene_0000000002"]
    assert [r.seed for r in SceneDataset(tmp_path)] == [0, 1, 2]


def test_several_folders_read_as_one(tmp_path):
    for name, seed in (("a", 3), ("b", 1)):
        SceneWriter(tmp_path / name, MANIFEST).add(record(seed))
    assert [r.seed for r in SceneDataset([tmp_path / "a", tmp_path / "b"])] == [3, 1]


def test_another_config_is_refused_by_name_and_leaves_the_folder_alone(tmp_path):
    SceneWriter(tmp_path, MANIFEST).add(record(0))
    before = (tmp_path / "manifest.json").read_bytes()
    with pytest.raises(DataError, match=r"differs in config; expected the same.*--out"):
        SceneWriter(tmp_path, {**MANIFEST, "config": {"judged": 9}})
    assert (tmp_path / "manifest.json").read_bytes() == before


def test_missing_and_damaged_data_are_named(tmp_path):
    with pytest.raises(DataError, match=r"no file .*manifest\.json"):
        SceneDataset(tmp_path)
    writer = SceneWriter(tmp_path, MANIFEST)
    for seed in range(3):
        writer.add(record(seed))
    (tmp_path / "scenes" / "scene_0000000001.npz").write_bytes(b"no archive at all")
    assert_equal(SceneDataset(tmp_path)[0], record(0))
    with pytest.raises(DataError, match=r"scene_0000000001\.npz is damaged"):
        SceneDataset(tmp_path)[1]
    [finding] = verify_dataset(tmp_path)
    assert finding.damaged and finding.lost == ("scene_0000000001",)


def test_scenes_from_before_they_were_kept_do_not_tell_what_came_along_or_held_again(tmp_path):
    one = record(3)
    arrays = record_arrays(one)
    del arrays["extra"], arrays["robust"]
    write_recipes(tmp_path / "recipes.npz", [one])
    with np.load(tmp_path / "recipes.npz") as file:
        old = {name: file[name] for name in file.files if name not in ("extra", "robust")}
    np.savez(tmp_path / "old.npz", **old)
    for found in (record_from_arrays(arrays), *read_recipes(tmp_path / "old.npz")):
        for name, labels in found.labels.items():
            assert labels.extra.tolist() == [NOT_TRIED] * len(one.labels[name])
            assert labels.robust.tolist() == [NOT_TRIED] * len(one.labels[name])
            np.testing.assert_array_equal(labels.target, one.labels[name].label)
            np.testing.assert_array_equal(labels.reason, one.labels[name].reason)


def test_half_written_files_are_not_scenes(tmp_path):
    writer = SceneWriter(tmp_path, MANIFEST)
    writer.add(record(0))
    (tmp_path / "scenes" / ".scene_0000000001.npz.123.part").write_bytes(b"half")
    assert len(SceneDataset(tmp_path)) == 1
    [note] = verify_dataset(tmp_path)
    assert not note.damaged and note.file.name == ".scene_0000000001.npz.123.part"
    writer.close()
    SceneWriter(tmp_path, MANIFEST).close()
    assert verify_dataset(tmp_path) == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda r: {"points": np.full_like(r.points, np.nan)}, "not finite"),
        (lambda r: {"normals": r.normals // 3}, "not of unit length"),
        (lambda r: {"normals": r.normals[:-1]}, "do not match the points"),
        (lambda r: {"obstacle": r.obstacle[:-1]}, "do not match the object names"),
        (lambda r: {"object_names": r.object_names[:1]}, "do not match the object names"),
        (lambda r: {"labels": {"other": r.labels["first"]}}, "expected some of"),
        (lambda r: {"labels": {}}, "no labels of any gripper"),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(r.labels["first"], object=r.labels["first"].object + 9),
                }
            },
            "belongs to no object",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(
                        r.labels["first"],
                        label=np.ones(7, np.int8),
                        kind=np.full(7, Kind.COLLISION, np.int8),
                    ),
                }
            },
            "colliding grasp is labelled a success",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(
                        r.labels["first"], world_from_tcp=r.labels["first"].world_from_tcp * 2
                    ),
                }
            },
            "quaternions",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(r.labels["first"], extra=np.full(7, 9, np.int8)),
                }
            },
            "extra objects",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(r.labels["first"], robust=np.full(7, 5, np.int8)),
                }
            },
            "robust trials held are not 7 numbers from -1 to 4",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(r.labels["first"], robust=np.zeros(6, np.int8)),
                }
            },
            "robust trials held are not 7 numbers",
        ),
        (
            lambda r: {
                "labels": {
                    **r.labels,
                    "first": replace(r.labels["first"], robust=np.ones(7, np.int8)),
                }
            },
            "a colliding grasp held when tried again",
        ),
    ],
)
def test_verify_names_what_is_wrong_with_a_record(change, expected):
    good = record(0)
    grippers = set(MANIFEST["grippers"])
    assert record_problems(good, grippers) == []
    problems = record_problems(replace(good, **change(good)), grippers)
    assert any(expected in problem for problem in problems), problems


def test_stats_count_labels(tmp_path):
    writer = SceneWriter(tmp_path, MANIFEST)
    records = [record(seed, in_bin=seed != 1) for seed in range(4)]
    for one in records:
        writer.add(one)
    stats = scene_stats(SceneDataset(tmp_path))
    assert stats["scenes"] == 4 and stats["in_bin"] == 3
    assert stats["mean_objects"] == 3 and stats["mean_points"] == 50
    held = sum(int(r.labels["first"].label.sum()) for r in records)
    first = stats["grippers"]["first"]
    assert first["labels"] == {"judged_success": held, "collision_failure": 28 - held}
    assert first["successes_per_scene"] == held / 4
    along = sum(int((r.labels["first"].extra > 0).sum()) for r in records)
    assert 0 < along < held
    assert first["successes_watched"] == held
    assert first["successes_with_others_along"] == along
    assert stats["grippers"]["second"]["scenes_with_success"] == 0
    counts = [np.bincount(r.labels["first"].robust + 1, minlength=6)[1:] for r in records]
    third = [np.bincount(r.labels["third"].robust + 1, minlength=6)[1:] for r in records]
    told = stats["robust"]["first"]
    assert told["held"] == {"judged_success": sum(counts).tolist()}
    assert stats["robust"]["all"]["grasps"] == sum(counts).sum() + sum(third).sum()
    assert told["success_held"] == pytest.approx(
        (sum(counts) @ np.arange(5)) / (4 * sum(counts).sum())
    )
    assert "second" not in stats["robust"] and "cpu_seconds_a_grasp" not in told


def test_the_target_is_the_share_that_held_where_it_is_known():
    one = record(0).labels["first"]
    known = replace(one, robust=np.array([NOT_TRIED, 0, 1, 2, 3, 4, NOT_TRIED], np.int8))
    expected = [one.label[0], 0.0, 0.25, 0.5, 0.75, 1.0, one.label[6]]
    assert known.target.tolist() == expected and known.target.dtype == np.float32
    assert len(GripperLabels.empty().target) == 0
    untried = replace(one, robust=GripperLabels.not_tried(7))
    joined = GripperLabels.joined([known, untried])
    assert joined.robust.tolist() == [*known.robust, *[NOT_TRIED] * 7]
    assert joined.part(joined.robust > 2).target.tolist() == [0.75, 1.0]

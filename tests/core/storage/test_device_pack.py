"""Device packs: what comes back, what is lost, and training from them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from dataset_records import labels, record
from made_packs import MANIFEST, heap, made_records, packed
from safetensors.numpy import load_file
from scipy.spatial import KDTree

from megrasp_core.cli import main
from megrasp_core.network import PRESETS
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.storage import (
    NOT_TRIED,
    DevicePack,
    GripperLabels,
    PackSource,
    SceneDataset,
    SceneRecord,
    SceneWriter,
    open_scenes,
    verify_pack,
    write_pack,
)
from megrasp_core.storage.device_pack import LAYOUT
from megrasp_core.training import (
    TrainConfig,
    TrainingJob,
    TrainingRun,
    read_entries,
    resume_training,
    scene_batch,
    train,
)

SETTINGS = SceneSettings()
CONFIG = TrainConfig(
    network=PRESETS["tiny"],
    model_id="tiny-run",
    grippers=("robotiq_2f85",),
    scenes_per_step=1,
    poses_per_scene=32,
    confidence_poses=8,
    warmup_steps=2,
    validation_pairs=1,
)


@pytest.fixture(scope="module")
def records() -> list[SceneRecord]:
    return made_records()


@pytest.fixture(scope="module")
def pack(records: list[SceneRecord], tmp_path_factory: pytest.TempPathFactory) -> DevicePack:
    return packed(tmp_path_factory.mktemp("pack") / "scenes.mgpack", records)


def test_scenes_come_back_with_their_facts(records, pack):
    assert len(pack) == 4 and pack.names == [r.name for r in records]
    for scene, expected in zip(pack, records, strict=True):
        for name in ("name", "seed", "object_names", "bin"):
            assert getattr(scene, name) == getattr(expected, name)
        np.testing.assert_array_equal(scene.gravity, expected.gravity)
    assert pack.meta["grippers"]["franka_hand"] == ["hash of franka_hand"]
    assert pack.meta["sources"] == [{"name": "set", "scenes": 4, "manifest": MANIFEST}]
    assert pack[-1].name == pack[3].name
    with pytest.raises(IndexError):
        pack[4]


def test_labels_come_back_within_their_rounding(records, pack):
    for scene, expected in zip(pack, records, strict=True):
        assert sorted(scene.labels) == sorted(expected.labels)
        for name, found in scene.labels.items():
            true = expected.labels[name]
            for part in ("object", "label", "kind", "reason", "robust"):
                np.testing.assert_array_equal(getattr(found, part), getattr(true, part))
            off = np.abs(found.world_from_tcp - true.world_from_tcp)
            assert off[:, :3].max() < 8e-6, "half a step of 2^-16 m, and float32"
            # Twice the distance of unit quaternions is the angle between them.
            assert np.degrees(2 * np.linalg.norm(off[:, 3:], axis=1)).max() < 0.004
            assert found.world_from_tcp.dtype == np.float32 and found.object.dtype == np.int16


def test_a_pack_keeps_what_held_again_and_is_as_ever_where_nothing_was_tried(tmp_path):
    def without(one: SceneRecord) -> SceneRecord:
        plain = {
            name: dataclasses.replace(part, robust=GripperLabels.not_tried(len(part)))
            for name, part in one.labels.items()
        }
        return dataclasses.replace(one, labels=plain)

    known = [heap(10, grasps=5), heap(11, grasps=5)]
    path = packed(tmp_path / "known.mgpack", known).path
    plain = packed(tmp_path / "plain.mgpack", [without(one) for one in known])
    assert set(load_file(path)) == set(LAYOUT) | {"robust"}
    assert set(load_file(plain.path)) == set(LAYOUT) and "optional" not in plain.meta
    for scene, one in zip(plain, known, strict=True):
        for name, part in scene.labels.items():
            assert part.robust.tolist() == [NOT_TRIED] * len(part)
            np.testing.assert_array_equal(part.target, one.labels[name].label)
    mixed = packed(tmp_path / "mixed.mgpack", [known[0], without(known[1])])
    for name, part in mixed[1].labels.items():
        assert (part.robust == NOT_TRIED).all()
        np.testing.assert_array_equal(mixed[0].labels[name].robust, known[0].labels[name].robust)
    assert verify_pack(path) == verify_pack(plain.path) == []


def test_the_nodes_of_inference_are_the_same_within_rounding(records, pack):
    for scene, expected in zip(pack, records, strict=True):
        found, true = scene.nodes(SETTINGS), expected.nodes(SETTINGS)
        np.testing.assert_array_equal(found.on_plane, true.on_plane)
        np.testing.assert_array_equal(found.gravity, true.gravity)
        off = (found.points + found.centroid) - (true.points + true.centroid)
        assert np.abs(off).max() < 8e-6
        cosine = (found.normals * true.normals).sum(axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 1.2


def test_other_seeds_still_draw_nodes_at_random_and_evenly(records, pack):
    true = records[0].points[~records[0].on_plane].astype(np.float64)
    whole, draws = (
        [source.nodes(SETTINGS, seed) for seed in (1, 2)] for source in (records[0], pack[0])
    )
    reach = []
    for nodes in (*whole, *draws):
        points = (nodes.points + nodes.centroid)[~nodes.on_plane]
        reach.append(np.percentile(KDTree(points).query(true)[0], 95))
        assert len(nodes.points) == 2048
        assert np.count_nonzero(nodes.on_plane) == np.count_nonzero(whole[0].on_plane)
    assert max(reach[2:]) < 1.2 * min(reach[:2]), "the surface is covered as well as from all"
    first, second = ({tuple(p) for p in np.round(n.points + n.centroid, 6)} for n in draws)
    assert 0.1 < len(first - second) / 2048 < 0.9, "the draws differ"
    again = pack[0].nodes(SETTINGS, 1)
    np.testing.assert_array_equal(again.points, draws[0].points)


def test_points_far_out_get_a_wider_step_and_stay_exact_to_it(tmp_path):
    scene = heap(5)
    moved = dataclasses.replace(
        scene, points=(scene.points * 4 + 20).astype(np.float16), labels={}
    )
    found = packed(tmp_path / "far.mgpack", [moved])[0]
    assert found.step == 2.0**-15, "1.92 m in 65535 steps"
    off, _ = KDTree(moved.points.astype(np.float64)).query(found.points)
    assert off.max() <= np.sqrt(3) * found.step / 2


def test_equal_scenes_give_equal_bytes(records, pack, tmp_path):
    for number in range(4):
        path = tmp_path / f"{number}.mgpack"
        packed(path, records)
        assert path.read_bytes() == pack.path.read_bytes()


def test_two_thousand_scenes_stay_below_60_megabytes(tmp_path):
    sizes = []
    for count in (1, 3):
        packed(tmp_path / "size.mgpack", [heap(seed) for seed in range(count)])
        sizes.append((tmp_path / "size.mgpack").stat().st_size)
    scene = (sizes[1] - sizes[0]) / 2
    assert sizes[0] + 1999 * scene < 60_000_000


def test_folders_and_packs_are_read_one_after_another(records, pack, tmp_path):
    writer = SceneWriter(tmp_path / "folder", MANIFEST)
    writer.add(records[1])
    writer.close()
    joined = open_scenes([tmp_path / "folder", pack.path, tmp_path / "folder"])
    assert [scene.name for scene in joined] == [records[1].name, *pack.names, records[1].name]


@pytest.fixture
def data(tmp_path) -> Path:
    """Small scenes with one top-down grasp, to be learnt."""
    writer = SceneWriter(tmp_path / "data", MANIFEST)
    rng = np.random.default_rng(0)
    for seed in range(8):
        grasps = labels(rng, 20, 3)
        grasps.world_from_tcp[:] = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]
        one = {"robotiq_2f85": dataclasses.replace(grasps, label=np.ones(20, np.int8))}
        writer.add(dataclasses.replace(record(seed), labels=one))
    writer.close()
    return tmp_path / "data"


def test_training_sees_the_same_in_a_pack_as_in_its_folder(data, tmp_path, capsys):
    path = tmp_path / "data.mgpack"
    assert main(["data", "pack", "--out", str(data), "--device", "--into", str(path)]) == 0
    assert f"wrote 8 scenes to {path}" in capsys.readouterr().out
    folder, pack = (list(read_entries([source]).values()) for source in (data, path))
    assert len(folder) == len(pack) == 8
    for entries in zip(folder, pack, strict=True):
        true, found = (
            scene_batch(
                *entry.nodes(SETTINGS, CONFIG.network),
                entry.tables,
                CONFIG,
                np.random.default_rng(0),
            )
            for entry in entries
        )
        np.testing.assert_allclose(found.nodes.points, true.nodes.points, atol=2e-5)
        for name, poses in true.positives.items():
            same = found.positives[name]
            np.testing.assert_allclose(same.poses.translation, poses.poses.translation, atol=2e-5)
            np.testing.assert_allclose(same.poses.rotation, poses.poses.rotation, atol=2e-4)
            np.testing.assert_array_equal(same.target, poses.target)
        assert set(found.labelled) == set(true.labelled) == {"robotiq_2f85"}


@pytest.mark.slow
def test_training_from_a_pack_learns_and_resumes(data, tmp_path):
    path = tmp_path / "data.mgpack"
    dataset = SceneDataset(data)
    write_pack(path, [PackSource("data", dataset.manifests[0], dataset, len(dataset))])
    losses = []
    config = dataclasses.replace(
        CONFIG, poses_per_scene=128, total_poses=128 * 20, learning_rate=5e-3, constant_share=0.9
    )
    job = TrainingJob((path,), tmp_path / "run")

    def heard(run: TrainingRun, values: dict[str, float]) -> None:
        losses.append(values["diffusion"])

    train(job, config, on_progress=heard)
    resume_training(job, total_poses=128 * 40, on_progress=heard)
    assert len(losses) == 40 and np.isfinite(losses).all()
    assert np.mean(losses[-10:]) < 0.96 * np.mean(losses[:10])


def test_the_command_line_refuses_what_does_not_go_together(data, capsys):
    for args in (["--points", "3000"], [str(data)]):
        assert main(["data", "pack", "--out", str(data), *args]) == 2
        assert "--device" in capsys.readouterr().err

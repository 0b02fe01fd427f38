"""The data generator on real physics: what it calls a success is one, and a seed is a scene."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.grippers import Gripper, load_gripper, procedural_rack
from megrasp_core.jobs import ExecutorConfig
from megrasp_core.library import (
    GraspLibrary,
    LabelSettings,
    LibraryConfig,
    continue_library,
    generate_library,
    label_object,
    load_library,
    pack_library,
)
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectSet, procedural_names
from megrasp_core.scenes import (
    SceneConfig,
    SceneJob,
    ViewShares,
    build_scene,
    generate_scenes,
    read_recipes,
    with_cloud,
    write_recipes,
)
from megrasp_core.scenes.generation import scene_grippers
from megrasp_core.scenes.scene_labels import NEAR_METRES, NEAR_RADIANS, near_moves
from megrasp_core.simulation import (
    FreeSpaceRig,
    World,
    approach_path,
    build_world,
    judge,
    start_depths,
)
from megrasp_core.storage import (
    NOT_TRIED,
    Kind,
    SceneDataset,
    SceneRecord,
    record_problems,
    verify_dataset,
)

OBJECTS = ObjectSet(procedural_names(5))
LABELS = LabelSettings(count=60, trials=24, target=12)
CONFIG = SceneConfig(
    ("robotiq_2f85",),
    objects=(3, 4),
    bin_share=1.0,
    bin_tilted=0.0,
    obstacle_share=0.0,
    image=(320, 240),
    judged=4,
    perturbed=1,
    colliding=6,
)


@pytest.fixture(scope="module")
def gripper() -> Gripper:
    return load_gripper("robotiq_2f85")


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    config = LibraryConfig(("robotiq_2f85",), OBJECTS, settings=LABELS)
    summary = generate_library(folder / "work", config)
    assert summary.done == 5 and not summary.failed
    before = {path: path.read_bytes() for path in (folder / "work").rglob("*.npz")}
    again = generate_library(folder / "work", config)
    assert again.done == 0, "a finished library is not made again"
    assert before == {path: path.read_bytes() for path in (folder / "work").rglob("*.npz")}
    pack_library(load_library(folder / "work"), folder / "library")
    return folder / "library"


@pytest.fixture(scope="module")
def library(packed: Path) -> GraspLibrary:
    return load_library(packed)


@pytest.fixture(scope="module")
def scene(library: GraspLibrary) -> SceneRecord:
    return build_scene(5, CONFIG, library, OBJECTS)


def frozen(value: object) -> object:
    """A value to compare bit for bit."""
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if is_dataclass(value):
        return {one.name: frozen(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, dict):
        return {key: frozen(one) for key, one in value.items()}
    return value


def world_of(scene: SceneRecord, gripper: Gripper) -> World:
    return build_world(
        [OBJECTS[name] for name in scene.object_names],
        gripper=gripper,
        bin=scene.bin,
        object_poses=matrix_from_pose7(scene.object_poses.astype(float)),
        visual=False,
    )


def gripper_poses(scene: SceneRecord, gripper: Gripper, rows: np.ndarray) -> np.ndarray:
    poses = matrix_from_pose7(scene.labels[gripper.name].world_from_tcp[rows].astype(float))
    return poses @ np.linalg.inv(gripper.gripper_from_tcp)


def test_free_space_labels_hold_when_tried_again(library, gripper):
    for name in OBJECTS.names:
        entry = library.get("robotiq_2f85", name)
        assert entry is not None and entry.gripper_hash == gripper.hash
        assert entry.success.sum() >= 4, name
        assert (entry.reason[entry.success] == "").all()
        assert (entry.reason[~entry.success] != "").all()
        assert "start_collision" not in entry.reason
    entry = library.get("robotiq_2f85", OBJECTS.names[0])
    rig = FreeSpaceRig(gripper, OBJECTS[OBJECTS.names[0]])
    poses = matrix_from_pose7(entry.successes) @ np.linalg.inv(gripper.gripper_from_tcp)
    # Poses were rounded to 0.01 mm in between, so not every one need repeat.
    assert sum(rig.trial(pose).success for pose in poses) >= len(poses) - 1


def test_a_packed_library_is_continued(library, tmp_path):
    assert continue_library(library, tmp_path) == 5
    assert continue_library(library, tmp_path) == 0
    config = LibraryConfig(("robotiq_2f85",), OBJECTS, settings=LABELS)
    assert generate_library(tmp_path, config).done == 0
    other = [replace(entry, gripper_hash="another") for entry in library]
    assert continue_library(GraspLibrary(other), tmp_path / "new") == 0


def test_labelling_stops_at_its_target_and_repeats_with_its_seed(gripper):
    model = OBJECTS[OBJECTS.names[1]]
    settings = replace(LABELS, target=2, fresh=1.0, failures=0.0)
    first = label_object(gripper, model, 1, settings=settings)
    second = label_object(gripper, model, 1, settings=settings)
    other = label_object(gripper, model, 2, settings=settings)
    assert first.success.sum() == 2 and first.tried <= LABELS.trials and first.drawn >= first.tried
    assert frozen(first) == frozen(second)
    assert frozen(first.object_from_tcp) != frozen(other.object_from_tcp)


def test_a_hopeless_object_is_given_up(gripper):
    # No start position of the fingers fits around it, so all candidates collide or miss.
    entry = label_object(gripper, OBJECTS["obstacle/000001"], 0, settings=LABELS)
    assert entry.drawn <= LABELS.count and entry.success.sum() == 0


def test_successes_are_moved_until_there_are_failures(gripper):
    settings = LabelSettings(trials=80, target=8)
    entry = label_object(gripper, OBJECTS[OBJECTS.names[1]], 1, settings=settings)
    assert entry.success.sum() >= 8 and (~entry.success).sum() == 8
    assert (entry.quality[entry.success] > 0).all() and (entry.quality <= 1).all()
    assert not entry.quality[~entry.success].any()


def test_the_same_seed_gives_the_same_scene_bit_for_bit(scene, library):
    assert frozen(scene) == frozen(build_scene(5, CONFIG, library, OBJECTS))
    assert frozen(scene.points) != frozen(build_scene(6, CONFIG, library, OBJECTS).points)


def test_a_record_is_sound_and_looks_like_its_scene(scene):
    assert record_problems(scene, {"robotiq_2f85"}) == []
    points, normals = scene.surface()
    assert scene.bin is not None
    half = np.array(scene.bin.inner) / 2
    margin = CONFIG.surface.region_margin + 0.001
    assert (np.abs(points[:, :2]) <= half[:2] + margin).all()
    assert abs(np.median(points[scene.on_plane, 2])) < 0.003
    assert (normals[scene.on_plane] @ [0, 0, 1]).mean() > 0.9
    # Every object that nothing covers is seen: points lie near the highest object's centre.
    highest = scene.object_poses[np.argmax(scene.object_poses[:, 2]), :3]
    assert np.linalg.norm(points[:, :2] - highest[:2], axis=1).min() < 0.02


def test_labels_are_what_the_simulation_says(scene, gripper):
    labels = scene.labels["robotiq_2f85"]
    world = world_of(scene, gripper)
    back = np.eye(4)
    back[2, 3] = -CONFIG.approach
    rows = np.flatnonzero((labels.label == 1) | (labels.kind == Kind.JUDGED))
    assert (labels.label == 1).sum() >= 4
    poses = gripper_poses(scene, gripper, rows)
    assert (start_depths(world, poses) <= 0.0011).all()
    for pose in poses:
        assert start_depths(world, approach_path(pose @ back, pose)).max() <= 0.0011
    tilt = -matrix_from_pose7(labels.world_from_tcp.astype(float))[:, 2, 2]
    kept = labels.kind != Kind.PERTURBED
    assert (tilt[kept] >= np.cos(CONFIG.tilt_bin) - 1e-6).all()
    colliding = np.flatnonzero(labels.kind == Kind.COLLISION)
    assert len(colliding) and (labels.label[colliding] == 0).all()
    assert (labels.extra[colliding] == NOT_TRIED).all()
    assert (labels.extra[labels.kind == Kind.JUDGED] != NOT_TRIED).all()
    assert (labels.extra[labels.label == 1] != NOT_TRIED).all()
    for pose, reason in zip(gripper_poses(scene, gripper, colliding), labels.reason[colliding]):
        if reason == "start_collision":
            assert start_depths(world, pose[None])[0] > 0.0009
        else:
            assert start_depths(world, approach_path(pose @ back, pose)).max() > 0.0009


def test_judged_labels_agree_with_the_verdict_without_sleeping_bodies(scene, gripper):
    labels = scene.labels["robotiq_2f85"]
    world = world_of(scene, gripper)
    start = world.save()
    rows = np.flatnonzero(labels.kind == Kind.JUDGED)
    same = []
    for row, pose in zip(rows, gripper_poses(scene, gripper, rows)):
        world.restore(start)
        verdict = judge(world, pose)
        same.append(verdict.success == bool(labels.label[row]))
        if verdict.success and same[-1]:
            assert verdict.target == labels.object[row]
            assert verdict.extra == labels.extra[row]
    # Symmetric copies inherit their label, and poses are rounded to float32: one may differ.
    assert len(same) >= 4 and sum(same) >= len(same) - 1


def test_no_obstacle_is_ever_a_target(library):
    config = replace(
        CONFIG, obstacle_share=1.0, objects=(2, 2), judged=3, bin_inner=(0.5, 0.4, 0.15)
    )
    record = build_scene(11, config, library, OBJECTS)
    assert record.obstacle.any() and not record.obstacle.all()
    for labels in record.labels.values():
        held = labels.object[labels.label == 1]
        assert not record.obstacle[held].any()


def test_tables_have_no_bin_and_may_be_seen_from_all_around(library):
    config = replace(
        CONFIG, bin_share=0.0, views=ViewShares(1.0), judged=1, perturbed=0, objects=(2, 2)
    )
    record = build_scene(5, config, library, OBJECTS)
    assert record.bin is None and record_problems(record) == []
    top = build_scene(5, replace(config, views=ViewShares(0.0)), library, OBJECTS)
    assert frozen(record.object_poses) == frozen(top.object_poses)

    def sides(one: SceneRecord) -> int:
        points, normals = one.surface()
        return int(((np.abs(normals[:, 2]) < 0.5) & (points[:, 2] > 0.008)).sum())

    assert sides(record) > 1.5 * sides(top)


def test_a_recipe_renders_the_same_cloud(scene, tmp_path):
    write_recipes(tmp_path / "recipes.npz", [scene])
    [recipe] = read_recipes(tmp_path / "recipes.npz")
    assert len(recipe.points) == 0
    again = with_cloud(recipe, CONFIG, OBJECTS)
    for name in ("points", "normals", "on_plane", "sensor", "gravity"):
        assert frozen(getattr(again, name)) == frozen(getattr(scene, name)), name


@pytest.mark.slow
def test_runs_resume_and_processes_give_the_same_scenes(packed, scene, tmp_path):
    job = SceneJob(CONFIG, packed, OBJECTS)
    summary = generate_scenes(tmp_path / "one", job, [5])
    assert summary.done == 1
    first = SceneDataset(tmp_path / "one")[0]
    assert frozen(first.points) == frozen(scene.points)
    file = tmp_path / "one" / "scenes" / "scene_0000000005.npz"
    stamp = file.stat().st_mtime_ns
    summary = generate_scenes(
        tmp_path / "one", job, [5, 6], ExecutorConfig(workers=2), shard_size=2
    )
    assert summary.done == 1 and not summary.failed
    assert not file.exists(), "two scenes make a shard here"
    assert stamp and [r.seed for r in SceneDataset(tmp_path / "one")] == [5, 6]
    generate_scenes(tmp_path / "two", job, [6])
    assert frozen(SceneDataset(tmp_path / "two")[0]) == frozen(SceneDataset(tmp_path / "one")[1])
    assert verify_dataset(tmp_path / "one") == []
    manifest = SceneDataset(tmp_path / "one").manifests[0]
    assert manifest["objects"] == list(OBJECTS.names)
    assert manifest["counts"] == {"scenes": 2} and manifest["versions"]["mujoco"]


@pytest.mark.slow
def test_ray_makes_the_same_library_and_scenes_bit_for_bit(packed, ray_cluster, tmp_path):
    where = ExecutorConfig("ray", workers=2)
    config = LibraryConfig(("robotiq_2f85",), OBJECTS, settings=LABELS)
    summary = generate_library(tmp_path / "work", config, where)
    assert summary.done == 5 and not summary.failed
    pack_library(load_library(tmp_path / "work"), tmp_path / "library")
    files = [folder / "robotiq_2f85.npz" for folder in (packed, tmp_path / "library")]
    assert files[0].read_bytes() == files[1].read_bytes()
    job = SceneJob(CONFIG, packed, OBJECTS)
    for name, executor in (("ray", where), ("local", None)):
        summary = generate_scenes(tmp_path / name, job, [5, 6], executor)
        assert summary.done == 2 and not summary.failed
    for seed in (5, 6):
        files = [
            tmp_path / name / "scenes" / f"scene_{seed:010d}.npz" for name in ("ray", "local")
        ]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_a_scene_is_labelled_for_a_drawn_part_of_the_grippers(packed, library):
    grippers = ("robotiq_2f85", "franka_hand", "vx300s_gripper")
    config = replace(CONFIG, grippers=grippers, grippers_per_scene=2)
    drawn = [scene_grippers(seed, config, in_bin=False) for seed in range(12)]
    assert {name for names in drawn for name in names} == set(grippers)
    assert all(len(names) == 2 for names in drawn)
    record = build_scene(6, config, library, OBJECTS)
    expected = scene_grippers(6, config, in_bin=record.bin is not None)
    assert sorted(record.labels) == sorted(expected)
    assert record_problems(record, set(grippers)) == []
    assert record_problems(record, {"robotiq_2f85"})
    with pytest.raises(InvalidRequestError, match="grippers_per_scene is 4; expected 1 to 3"):
        scene_grippers(0, replace(config, grippers_per_scene=4), in_bin=True)


def test_hands_are_drawn_by_their_weight():
    config = replace(
        CONFIG,
        grippers=("robotiq_2f85", "allegro_hand"),
        grippers_per_scene=1,
        hands_in_bins=0.0,
        hands_on_tables=3.0,
    )
    in_bins = [scene_grippers(seed, config, in_bin=True)[0] for seed in range(40)]
    assert set(in_bins) == {"robotiq_2f85"}
    hands = sum(
        scene_grippers(seed, config, in_bin=False)[0] == "allegro_hand" for seed in range(400)
    )
    assert 260 < hands < 340


def test_a_scene_is_labelled_for_procedural_grippers_too(library):
    config = replace(CONFIG, procedural_grippers=8, procedural_per_scene=2, bin_share=0.0)
    record = build_scene(6, config, library, OBJECTS)
    names = scene_grippers(6, config, in_bin=False)
    assert list(record.labels) == names
    assert len(names) == 3 and set(names[1:]) <= set(procedural_rack(8))
    assert all(load_gripper(name).name == name for name in names)
    assert sum(len(record.labels[name]) for name in names[1:])


def test_near_misses_lie_in_the_stated_range():
    moves = near_moves(500, np.random.default_rng(0))
    length = np.linalg.norm(moves[:, :3, 3], axis=1)
    angle = np.arccos(0.5 * (np.trace(moves[:, :3, :3], axis1=1, axis2=2) - 1.0))
    for value, (low, high) in ((length, NEAR_METRES), (angle, NEAR_RADIANS)):
        assert low - 1e-9 <= value.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < value.max() <= high + 1e-9
    assert near_moves(0, np.random.default_rng(0)).shape == (0, 4, 4)


def test_bad_jobs_are_refused(packed, tmp_path):
    with pytest.raises(DataError, match="object set is empty"):
        generate_scenes(tmp_path, SceneJob(CONFIG, packed, ObjectSet([])), [1])

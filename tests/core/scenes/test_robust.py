"""Robust labels on real physics: what is tried again, what its share is made of, and that a seed
decides on all of it.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.cli import main
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.jobs import ExecutorConfig, runs_of
from megrasp_core.library import GraspLibrary
from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix
from megrasp_core.objects import ObjectSet
from megrasp_core.scenes import (
    Layout,
    RobustSettings,
    RobustTrials,
    SceneConfig,
    generate_robust,
    region_of,
    robust_labels,
)
from megrasp_core.scenes.robust import COLLISIONS
from megrasp_core.scenes.scene_labels import SceneLabeller
from megrasp_core.storage import (
    NOT_TRIED,
    ROBUST_TRIALS,
    GripperLabels,
    Kind,
    SceneDataset,
    SceneRecord,
    SceneWriter,
    record_problems,
    scene_stats,
    verify_dataset,
)

GRIPPER = "robotiq_2f85"
OBJECTS = ObjectSet(())
NAMES = ("procedural/000003", "procedural/000004")
SETTINGS = RobustSettings(successes=2, near_misses=2, failures=1)
FIELDS = [field.name for field in dataclasses.fields(GripperLabels)]


@pytest.fixture(scope="module")
def gripper() -> Gripper:
    return load_gripper(GRIPPER)


@pytest.fixture(scope="module")
def record(gripper: Gripper) -> SceneRecord:
    """Two objects on a table, labelled by the verdict."""
    poses = np.tile(np.eye(4), (len(NAMES), 1, 1))
    for place, name in enumerate(NAMES):
        poses[place, :3, 3] = 0.15 * place, 0.0, -OBJECTS[name].vertices[:, 2].min()
    config = SceneConfig((GRIPPER,), judged=10, judged_library=0, perturbed=4, colliding=4)
    seven = pose7_from_matrix(poses).astype(np.float32)
    layout = Layout(NAMES, np.zeros(len(NAMES), bool), seven, None, region_of(None, config))
    labeller = SceneLabeller(layout, gripper, GraspLibrary([]), OBJECTS, 1, config)
    points = np.array([[0.0, 0.0, 0.01 * place] for place in range(20)], np.float16)
    return SceneRecord(
        name="scene_0000000001",
        seed=1,
        object_names=NAMES,
        object_poses=seven,
        obstacle=layout.obstacle,
        bin=None,
        points=points,
        normals=np.tile([0, 0, 127], (len(points), 1)).astype(np.int8),
        on_plane=np.zeros(len(points), bool),
        sensor=np.array([0, 0, 0.8], np.float32),
        gravity=np.array([0, 0, -1], np.float32),
        labels={GRIPPER: labeller.labels()},
    )


@pytest.fixture(scope="module")
def made(record: SceneRecord, gripper: Gripper) -> RobustTrials:
    return robust_labels(record, gripper, OBJECTS, SETTINGS, seed=3)


def assert_same(first: GripperLabels, second: GripperLabels) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)


def rows_of(labels: GripperLabels, known: GripperLabels) -> list[int | None]:
    """Row of `known` that has the pose of each label; None for new poses."""
    at = {pose.tobytes(): row for row, pose in enumerate(known.world_from_tcp)}
    return [at.get(pose.tobytes()) for pose in labels.world_from_tcp]


def test_successes_failures_and_near_misses_are_tried_again(record, made):
    known, labels = record.labels[GRIPPER], made.labels
    rows = rows_of(labels, known)
    assert len(labels) == 5 and rows[3:] == [None, None]
    assert labels.label[:3].tolist() == [1, 1, 0]
    for place, row in enumerate(rows[:3]):
        assert row is not None and known.kind[row] != Kind.COLLISION
        for name in FIELDS[:-1]:
            np.testing.assert_array_equal(
                getattr(labels, name)[place], getattr(known, name)[row], err_msg=name
            )
    assert (labels.kind[3:] == Kind.PERTURBED).all()
    assert labels.robust.dtype == np.int8
    assert (labels.robust >= 0).all() and (labels.robust <= ROBUST_TRIALS).all()
    hit = np.isin(labels.reason, COLLISIONS)
    assert (labels.robust[hit] == 0).all() and (labels.extra[hit] == NOT_TRIED).all()
    # One plain trial of each near miss, and none more of those that collide.
    assert made.trials == ROBUST_TRIALS * int((~hit).sum()) + 2
    lost = int((ROBUST_TRIALS - labels.robust[~hit]).sum())
    assert sum(made.failed.values()) == lost and "success" not in made.failed
    changed = dataclasses.replace(record, labels={GRIPPER: labels})
    assert record_problems(changed) == []


def test_near_misses_lie_about_successes(record, made):
    known = record.labels[GRIPPER]
    held = matrix_from_pose7(known.world_from_tcp[known.label == 1].astype(float))
    for pose in matrix_from_pose7(made.labels.world_from_tcp[3:].astype(float)):
        off = np.linalg.norm(held[:, :3, 3] - pose[:3, 3], axis=1)
        near = np.flatnonzero((off > 0.0019) & (off < 0.0101))
        turn = [np.arccos((np.trace(held[n, :3, :3].T @ pose[:3, :3]) - 1) / 2) for n in near]
        assert any(0.049 < angle < 0.301 for angle in turn)


def test_the_same_seed_gives_the_same_labels_and_another_does_not(record, gripper, made):
    again = robust_labels(record, gripper, OBJECTS, SETTINGS, seed=3)
    assert_same(made.labels, again.labels)
    assert made.failed == again.failed and made.trials == again.trials
    other = robust_labels(record, gripper, OBJECTS, SETTINGS, seed=4)
    assert rows_of(made.labels, other.labels)[3:] == [None, None]


def test_a_grasp_has_its_label_whichever_others_are_tried(record, gripper, made):
    alone = dataclasses.replace(SETTINGS, successes=1, near_misses=0, failures=1)
    few = robust_labels(record, gripper, OBJECTS, alone, seed=3)
    assert_same(few.labels, made.labels.part([0, 2]))
    more = dataclasses.replace(SETTINGS, near_misses=0, failures=0, successes=4)
    assert_same(
        robust_labels(record, gripper, OBJECTS, more, seed=3).labels.part([0, 1]),
        made.labels.part([0, 1]),
    )


def test_without_any_difference_a_grasp_does_what_it_did(record, gripper):
    still = dataclasses.replace(
        SETTINGS, successes=3, near_misses=0, metres=0.0, radians=0.0, vary=("pose",)
    )
    labels = robust_labels(record, gripper, OBJECTS, still).labels
    assert labels.label.tolist() == [1, 1, 1, 0]
    assert labels.robust.tolist() == [4, 4, 4, 0]


def test_harder_conditions_hold_less(record, gripper):
    amounts = dataclasses.replace(SETTINGS, successes=3, near_misses=0, failures=0)
    hard = (
        dataclasses.replace(amounts, vary=("pose",), metres=0.03),
        dataclasses.replace(amounts, vary=("friction",), friction=(0.001, 0.002)),
        dataclasses.replace(amounts, vary=("mass",), mass=(900.0, 1000.0)),
        dataclasses.replace(amounts, vary=("force",), force=(0.001, 0.002)),
    )
    for settings in hard:
        robust = robust_labels(record, gripper, OBJECTS, settings).labels.robust
        assert robust.sum() < 0.5 * ROBUST_TRIALS * len(robust), settings


def test_copies_library_grasps_and_collisions_are_left_out(record, gripper):
    known = record.labels[GRIPPER]
    assert (known.kind == Kind.COLLISION).any()
    everything = dataclasses.replace(SETTINGS, successes=99, near_misses=0, failures=99)
    made = robust_labels(
        dataclasses.replace(record, labels={GRIPPER: known}),
        gripper,
        OBJECTS,
        dataclasses.replace(everything, vary=("mass",), mass=(1.0, 1.0)),
    ).labels
    assert not np.isin(made.reason, COLLISIONS).any() and (made.kind != Kind.COLLISION).all()
    places = {place.tobytes() for place in made.world_from_tcp[:, :3]}
    assert len(places) == len(made), "one of the symmetric copies of a grasp"
    judged = known.part((known.kind != Kind.COLLISION) & ~np.isin(known.reason, COLLISIONS))
    assert places == {place.tobytes() for place in judged.world_from_tcp[:, :3]}
    untried = dataclasses.replace(known, kind=np.full_like(known.kind, Kind.LIBRARY))
    old = dataclasses.replace(record, labels={GRIPPER: untried})
    assert len(robust_labels(old, gripper, OBJECTS, everything).labels) == 0
    none = dataclasses.replace(record, labels={})
    assert robust_labels(none, gripper, OBJECTS).trials == 0


def test_settings_are_checked():
    with pytest.raises(
        InvalidRequestError, match="failures -1 was given; expected a whole number from 0"
    ):
        RobustSettings(failures=-1)
    with pytest.raises(InvalidRequestError, match="at least one of pose, friction, mass, force"):
        RobustSettings(vary=())
    with pytest.raises(InvalidRequestError, match="colour"):
        RobustSettings(vary=("colour",))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def data(record: SceneRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three scenes with labels and one with none."""
    folder = tmp_path_factory.mktemp("data") / "scenes"
    writer = SceneWriter(folder, {"config": "test"})
    for seed in (1, 2, 3):
        writer.add(dataclasses.replace(record, seed=seed, name=f"scene_{seed:010d}"))
    empty = {GRIPPER: GripperLabels.empty()}
    writer.add(dataclasses.replace(record, seed=4, name="scene_0000000004", labels=empty))
    writer.close()
    return folder


def options(data: Path, out: Path, *more: object) -> list[str]:
    amounts = ("--successes", 1, "--near-misses", 1, "--failures", 0, "--seed", 5)
    command = ("data", "robust", "--data", data, "--out", out, *amounts, *more)
    return [str(word) for word in command]


def arrays(folder: Path) -> dict[str, list[bytes]]:
    return {
        one.name: [getattr(one.labels[GRIPPER], name).tobytes() for name in FIELDS]
        for one in SceneDataset(folder)
    }


@pytest.mark.slow
def test_a_run_resumes_and_processes_give_the_same_labels(data, record, tmp_path, capsys):
    assert main(options(data, tmp_path / "one", "-n", 3)) == 0
    assert "4 grasps" in capsys.readouterr().out
    first = arrays(tmp_path / "one")
    assert len(first) == 2, "scenes are whole"
    assert main(options(data, tmp_path / "one")) == 0
    assert "1 scenes in" in capsys.readouterr().out
    whole = arrays(tmp_path / "one")
    assert len(whole) == 3 and first.items() <= whole.items()
    assert main(options(data, tmp_path / "one")) == 0
    assert "0 scenes in" in capsys.readouterr().out
    settings = RobustSettings(1, 1, 0)
    summary, grasps = generate_robust(
        data, tmp_path / "two", settings, ExecutorConfig(workers=2), seed=5
    )
    assert summary.done == 3 and grasps == 6 and not summary.failed
    assert arrays(tmp_path / "two") == whole
    assert verify_dataset(tmp_path / "two") == []
    for one in SceneDataset(tmp_path / "one"):
        np.testing.assert_array_equal(one.points, record.points)
        np.testing.assert_array_equal(one.object_poses, record.object_poses)
        assert (one.labels[GRIPPER].robust != NOT_TRIED).all()


def test_what_came_of_it_and_what_it_took_is_told(data, tmp_path):
    settings = RobustSettings(2, 0, 1)
    generate_robust([data], tmp_path / "out", settings)
    [run] = runs_of(tmp_path / "out")
    took = run["robust"][GRIPPER]
    assert run["grasps"] == took["grasps"] == 9 and took["trials"] == 36
    assert 0 < took["cpu_seconds"] <= run["cpu_seconds"] + 0.1
    stats = scene_stats(SceneDataset(tmp_path / "out"), runs_of(tmp_path / "out"))
    told = stats["robust"][GRIPPER]
    assert told == {**stats["robust"]["all"]}
    assert sum(sum(counts) for counts in told["held"].values()) == 9
    held = sum(np.array(c) for name, c in told["held"].items() if name.endswith("_success"))
    assert told["success_held"] == pytest.approx((held @ np.arange(5)) / (4 * 6))
    every = sum(np.array(counts) for counts in told["held"].values()) @ np.arange(5)
    assert sum(told["failed"].values()) == 36 - every
    assert told["cpu_seconds_a_grasp"] == pytest.approx(took["cpu_seconds"] / 9)
    assert "robust" not in scene_stats(SceneDataset(data))


def test_bad_runs_are_refused(data, tmp_path, capsys):
    with pytest.raises(DataError, match="is what is read; expected another folder"):
        generate_robust(data, data)
    other = SceneWriter(tmp_path / "twins", {"config": "other"})
    other.add(SceneDataset(data)[0])
    other.close()
    with pytest.raises(DataError, match=r"1 scenes, scene_0000000001 among them, are in two"):
        generate_robust([data, tmp_path / "twins"], tmp_path / "out")
    for wrong, said in (
        (("-n", 0), "--num-grasps 0 was given; expected at least 1"),
        (("--near-misses", -1), "--near-misses -1 was given; expected 0 or more"),
        (("--successes", 0, "--near-misses", 0), "are all 0; expected something to try"),
        (("--seed", -2), "--seed -2 was given"),
    ):
        assert main(options(data, tmp_path / "out", *wrong)) == 2
        assert said in capsys.readouterr().err
    assert main(options(tmp_path / "nowhere", tmp_path / "out")) == 2
    assert not (tmp_path / "out").exists()
    assert main(options(data, tmp_path / "made", "-n", 1)) == 0
    assert main(options(data, tmp_path / "made", "--vary", "mass")) == 2
    assert "differs in robust" in capsys.readouterr().err


def test_ray_gives_the_same_labels(data, ray_cluster, tmp_path):
    settings = RobustSettings(1, 0, 0)
    for name, executor in (("ray", ExecutorConfig("ray", workers=2)), ("local", None)):
        summary, _ = generate_robust(data, tmp_path / name, settings, executor)
        assert summary.done == 3 and not summary.failed
    assert arrays(tmp_path / "ray") == arrays(tmp_path / "local")

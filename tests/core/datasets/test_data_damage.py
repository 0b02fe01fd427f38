"""Damaged files: `megrasp data verify` names every one of them and what is lost, moves them aside
on demand, and the same command makes the rest anew.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_library import made_library
from made_runs import (
    GRIPPER,
    SCENES,
    Run,
    contents,
    grasps_command,
    library_file,
    made_record,
    scenes_command,
)

from megrasp_core.cli import main
from megrasp_core.datasets import (
    SceneDataset,
    SceneWriter,
    load_library,
    pack_library,
    verify_dataset,
    verify_library,
    write_grasp_set,
)
from megrasp_core.datasets.files import DamagedError, open_npz, text_array, write_npz
from megrasp_core.errors import DataError


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library_file(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module")
def made(library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of three shards, the last one still loose."""
    folder = tmp_path_factory.mktemp("made")
    assert Run(scenes_command(folder / "data", library)).ended() == 0
    last = folder / "data" / "shards" / "shard_00002.npz"
    with open_npz(last) as file:
        for seed in range(8, SCENES):
            name = f"scene_{seed:010d}"
            part = {key: file[f"{name}/{key}"] for key in _keys(file, name)}
            write_npz(folder / "data" / "scenes" / f"{name}.npz", part)
    last.unlink()
    return folder / "data"


def _keys(file, name: str) -> list[str]:
    return [key.split("/")[1] for key in file if key.startswith(f"{name}/")]


@pytest.fixture
def data(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data"


def cut(path: Path) -> None:
    """Lose the second half."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def garbage(path: Path) -> None:
    path.write_bytes(b"not what was written here")


def flip(path: Path, at: float = 0.5) -> None:
    """One byte comes back wrong."""
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 0xFF
    path.write_bytes(bytes(content))


def told(capsys, *args: object) -> tuple[int, str]:
    capsys.readouterr()
    code = main([str(a) for a in ("data", "verify", *args)])
    return code, capsys.readouterr().out


DAMAGE = [
    ("shards/shard_00000.npz", cut, "lost: scene_0000000000 to scene_0000000002"),
    ("shards/shard_00000.npz", empty, ""),
    ("shards/shard_00001.npz", flip, "scene_000000000"),
    ("shards/shard_00001.npz", garbage, ""),
    ("scenes/scene_0000000009.npz", cut, "lost: scene_0000000009"),
    ("scenes/scene_0000000010.npz", flip, "lost: scene_0000000010"),
    ("manifest.json", cut, ""),
    ("manifest.json", empty, ""),
]


@pytest.mark.parametrize(("name", "harm", "lost"), DAMAGE)
def test_damage_is_named_moved_aside_and_made_anew(
    name, harm: Callable[[Path], None], lost, data, made, library, tmp_path, capsys
):
    harm(data / name)
    harmed = (data / name).read_bytes()
    files = {path: path.read_bytes() for path in data.rglob("*.*")}
    code, said = told(capsys, "--out", data)
    assert code == 1 and f"damaged: {data / name}: " in said and lost in said, said
    assert "1 damaged" in said and "--repair" in said
    assert files == {path: path.read_bytes() for path in data.rglob("*.*")}, "only read so far"
    code, said = told(capsys, "--out", data, "--repair")
    assert code == 0 and f"moved to {data / 'damaged' / name}" in said
    assert (data / "damaged" / name).read_bytes() == harmed and not (data / name).exists()
    run = Run(scenes_command(data, library))
    assert run.ended() == 0, run.said()
    assert told(capsys, "--out", data) == (0, f"0 damaged, 0 notes; {data}\n")
    assert contents(data) == contents(made)
    assert (data / "damaged" / name).read_bytes() == harmed


@pytest.mark.parametrize(("name", "harm", "_"), [d for d in DAMAGE if "manifest" not in d[0]])
def test_the_generator_goes_on_by_itself(name, harm, _, data, made, library, tmp_path, capsys):
    harm(data / name)
    run = Run(scenes_command(data, library))
    assert run.ended() == 0, run.said()
    if told(capsys, "--out", data)[0]:
        # Damage deep within a shard is what only a full reading finds.
        assert "shard_00001" in name and harm is flip
        assert told(capsys, "--out", data, "--repair")[0] == 0
        run = Run(scenes_command(data, library))
        assert run.ended() == 0
    else:
        assert f"moved to {data / 'damaged' / name}" in run.said()
    assert contents(data) == contents(made)
    assert (data / "damaged" / name).is_file()


def test_a_damaged_manifest_stops_the_generator_before_it_mixes_data(data, library, tmp_path):
    cut(data / "manifest.json")
    run = Run(scenes_command(data, library))
    assert run.ended() == 2
    assert "manifest.json is damaged" in run.said() and "--repair" in run.said()


def test_all_damaged_shards_are_named_at_once(data):
    for name in ("shard_00000.npz", "shard_00001.npz"):
        cut(data / "shards" / name)
    with pytest.raises(DataError, match=r"shard_00000\.npz.*shard_00001\.npz.*verify.*--repair"):
        SceneDataset(data)
    assert [f.file.name for f in verify_dataset(data)] == ["shard_00000.npz", "shard_00001.npz"]


def test_what_is_whole_in_a_damaged_shard_is_kept(data, made, capsys):
    """One byte within the points of a scene: its three neighbours are not made again."""
    shard = data / "shards" / "shard_00000.npz"
    content = shard.read_bytes()
    place = content.index(b"scene_0000000002/points.npy") + 200
    shard.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    names = [f"scene_{seed:010d}" for seed in range(4)]
    [finding] = verify_dataset(data)
    assert finding.lost == ("scene_0000000002",)
    assert finding.kept == tuple(name for name in names if name != "scene_0000000002")
    assert told(capsys, "--out", data, "--repair")[0] == 0
    expected = contents(made)
    del expected["scene_0000000002"]
    assert contents(data) == expected
    assert verify_dataset(data)[0].problem == "it counts 12 scenes, 11 are there"


def test_a_lost_shard_never_lets_another_be_replaced(tmp_path):
    """Shards are numbered on, not counted."""
    writer = SceneWriter(tmp_path, {"config": "test"}, shard_size=2)
    for seed in range(4):
        writer.add(made_record(seed))
    writer.close()
    (tmp_path / "shards" / "shard_00000.npz").unlink()
    second = (tmp_path / "shards" / "shard_00001.npz").read_bytes()
    for number in (2, 3):
        writer = SceneWriter(tmp_path, {"config": "test"}, shard_size=2)
        writer.add(made_record(2 * number))
        writer.add(made_record(2 * number + 1))
        writer.close()
        assert (tmp_path / "shards" / f"shard_{number:05d}.npz").is_file()
    assert (tmp_path / "shards" / "shard_00001.npz").read_bytes() == second
    assert [r.seed for r in SceneDataset(tmp_path)] == [2, 3, 4, 5, 6, 7]


def test_a_scene_damaged_under_way_does_not_stop_the_writer(tmp_path):
    writer = SceneWriter(tmp_path, {"config": "test"}, shard_size=3)
    for seed in range(2):
        writer.add(made_record(seed))
    flip(tmp_path / "scenes" / "scene_0000000000.npz")
    for seed in range(2, 5):
        writer.add(made_record(seed))
    assert 0 not in writer and len(writer) == 4
    assert (tmp_path / "damaged" / "scenes" / "scene_0000000000.npz").is_file()
    assert [r.seed for r in SceneDataset(tmp_path)] == [1, 2, 3, 4]
    assert len(list((tmp_path / "shards").iterdir())) == 1


def test_scenes_in_the_wrong_file_are_damage(data):
    scenes = data / "scenes"
    shutil.copy(scenes / "scene_0000000009.npz", scenes / "scene_0000000077.npz")
    [finding] = verify_dataset(data)
    assert finding.lost == ("scene_0000000077",)
    assert "it is named scene_0000000009 within" in finding.problem


def test_no_damaged_byte_passes_for_data(tmp_path):
    """Each byte in turn: the arrays come back as they were, or an error does."""
    arrays = {"meta": text_array("what it is"), "points": np.arange(60.0).reshape(20, 3)}
    path = tmp_path / "file.npz"
    write_npz(path, arrays)
    content = path.read_bytes()
    noticed = 0
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            with open_npz(path) as file:
                for key, value in arrays.items():
                    np.testing.assert_array_equal(file[key], value)
        except (DamagedError, KeyError):
            noticed += 1
    assert noticed > len(content) / 2
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(DamagedError):
            open_npz(path)


@pytest.fixture(scope="module")
def grasps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grasps")
    run = Run(grasps_command(folder / "data"))
    assert run.ended() == 0, run.said()
    assert verify_library(folder / "data") == []
    return folder / "data"


def frozen(folder: Path) -> dict[str, bytes]:
    files = folder.rglob("*.npz")
    return {str(p.relative_to(folder)): p.read_bytes() for p in files if "damaged" not in p.parts}


PAIRS = [f"{GRIPPER}/procedural__00000{number}.npz" for number in range(6)]


def test_a_damaged_library_is_named_moved_aside_and_made_anew(grasps, tmp_path, capsys):
    folder = tmp_path / "data"
    shutil.copytree(grasps, folder)
    for name, harm in zip(PAIRS, (cut, flip, empty)):
        harm(folder / name)
    harmed = {name: (folder / name).read_bytes() for name in PAIRS[:3]}
    with pytest.raises(DataError, match=r"3 of the 6 files.*000000.npz.*000001.npz.*000002.npz"):
        load_library(folder)
    code, said = told(capsys, "--out", folder)
    assert code == 1 and "3 damaged" in said
    assert all(f"{folder / name}: " in said for name in PAIRS[:3])
    assert f"lost: {GRIPPER} with procedural/000001" in said
    code, said = told(capsys, "--out", folder, "--repair")
    assert code == 0 and "3 moved aside" in said
    assert len(load_library(folder)) == 3
    run = Run(grasps_command(folder))
    assert run.ended() == 0 and "3 pairs" in run.said(), run.said()
    assert frozen(folder) == frozen(grasps)
    assert harmed == {name: (folder / "damaged" / name).read_bytes() for name in PAIRS[:3]}
    assert told(capsys, "--out", folder)[0] == 0


def test_scenes_are_not_begun_with_a_damaged_library(library, tmp_path):
    file = tmp_path / library.name
    shutil.copy(library, file)
    cut(file)
    run = Run(scenes_command(tmp_path / "data", file))
    assert run.ended() == 2 and f"{file} is damaged" in run.said()
    assert not (tmp_path / "data").exists()


def test_the_generator_makes_damaged_pairs_anew_by_itself(grasps, tmp_path):
    folder = tmp_path / "data"
    shutil.copytree(grasps, folder)
    cut(folder / PAIRS[4])
    flip(folder / PAIRS[5])
    (folder / PAIRS[0]).unlink()
    run = Run(grasps_command(folder))
    assert run.ended() == 0 and "3 pairs" in run.said(), run.said()
    assert f"moved to {folder / 'damaged' / PAIRS[4]}" in run.said()
    assert frozen(folder) == frozen(grasps)


def test_a_killed_library_run_goes_on(grasps, tmp_path):
    folder = tmp_path / "data"
    death = ("replace", ".procedural*.part", 4)
    assert Run(grasps_command(folder), death=death).ended() == -9
    assert len(load_library(folder)) == 3
    run = Run(grasps_command(folder))
    assert run.ended() == 0 and "3 pairs" in run.said()
    assert frozen(folder) == frozen(grasps)


def test_no_room_for_pairs_ends_the_run(grasps, tmp_path):
    folder = tmp_path / "data"
    shutil.copytree(grasps, folder)
    for name in PAIRS[2:]:
        (folder / name).unlink()
    run = Run(grasps_command(folder), limit=500)
    assert run.ended() == 1 and "0 pairs" in run.said()
    assert "stopped: 2 results in a row could not be written" in run.said()
    assert Run(grasps_command(folder)).ended() == 0
    assert frozen(folder) == frozen(grasps)


def changed(path: Path, **arrays: Callable[[np.ndarray], np.ndarray]) -> None:
    """The same file with other numbers, whole as far as its checksums tell."""
    with open_npz(path) as file:
        content = dict(file)
    write_npz(path, {key: arrays.get(key, np.asarray)(value) for key, value in content.items()})


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"quaternion": lambda a: a // 2}, "quaternions are not of unit length"),
        ({"quality": lambda a: a + 1}, "failures have a quality"),
        ({"success": lambda a: ~a}, "have a reason for failing"),
        ({"reason": lambda a: a + 9}, "out of bounds"),
        ({"success": lambda a: a[1:]}, "does not hold the 11 grasps that it counts"),
        ({"position": lambda a: a[:, :2]}, "does not hold the 11 grasps that it counts"),
    ],
)
def test_what_cannot_be_right_in_a_library_is_damage(change, expected, grasps, tmp_path):
    shutil.copytree(grasps, tmp_path / "data")
    name = f"{GRIPPER}/procedural__000004.npz"
    changed(tmp_path / "data" / name, **change)
    [finding] = verify_library(tmp_path / "data")
    assert finding.damaged and finding.file == tmp_path / "data" / name
    assert expected in finding.problem


def test_pairs_in_the_wrong_file_are_damage(grasps, tmp_path):
    shutil.copytree(grasps, tmp_path / "data")
    shutil.copy(tmp_path / "data" / PAIRS[1], tmp_path / "data" / PAIRS[2])
    findings = verify_library(tmp_path / "data")
    assert [(f.file.name, f.damaged) for f in findings] == [
        ("procedural__000002.npz", True),
        ("procedural__000002.npz", False),
    ]
    assert "whose file is robotiq_2f85/procedural__000001.npz" in findings[0].problem


def test_another_version_of_a_gripper_is_a_note_and_no_damage(grasps, tmp_path, capsys):
    entries = [replace(entry, gripper_hash="older") for entry in load_library(grasps)]
    for entry in [*entries, *made_library(other="no_such_gripper")]:
        write_grasp_set(tmp_path / "data", entry)
    code, said = told(capsys, "--out", tmp_path / "data")
    assert code == 0 and "0 damaged, 3 notes" in said
    assert f"6 pairs of {GRIPPER} belong to another version of its description" in said
    assert "2 pairs of no_such_gripper, whose description cannot be loaded" in said


def test_packed_libraries_are_verified_too(grasps, tmp_path, capsys):
    pack_library(load_library(grasps), tmp_path)
    file = tmp_path / f"{GRIPPER}.npz"
    for path in (tmp_path, file):
        assert told(capsys, "--out", path) == (0, f"0 damaged, 0 notes; {path}\n")
    flip(file)
    code, said = told(capsys, "--out", tmp_path)
    assert code == 1 and f"lost: all of {GRIPPER}" in said
    assert told(capsys, "--out", file, "--repair")[0] == 0
    assert (tmp_path / "damaged" / file.name).is_file() and not file.exists()


def test_files_that_are_something_else_are_refused_and_left_alone(made, tmp_path, capsys):
    shutil.copytree(made, tmp_path / "parent" / "data")
    capsys.readouterr()
    assert main(["data", "verify", "--out", str(tmp_path / "parent"), "--repair"]) == 2
    assert "is no grasp library" in capsys.readouterr().err
    assert not (tmp_path / "parent" / "damaged").exists()


def test_repair_waits_for_no_generator(data, capsys):
    cut(data / "shards" / "shard_00000.npz")
    folder = data.parent / "other"
    writer = SceneWriter(folder, {"config": "test"})
    cut_file = folder / "scenes" / "scene_0000000001.npz"
    writer.add(made_record(1))
    cut(cut_file)
    assert main(["data", "verify", "--out", str(folder), "--repair"]) == 2
    assert "another run is writing" in capsys.readouterr().err and cut_file.exists()
    writer.close()
    assert main(["data", "verify", "--out", str(folder), "--repair"]) == 0

"""Damaged files: `megrasp data verify` names every one of them and what is lost, moves them aside
on demand, and the same command makes the rest anew.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from harms import cut, empty, flip, garbage
from made_runs import SCENES, Run, contents, made_record, scenes_command

from megrasp_core.cli import main
from megrasp_core.errors import DataError
from megrasp_core.storage import (
    DamagedError,
    SceneDataset,
    SceneWriter,
    open_npz,
    text_array,
    verify_dataset,
    write_npz,
)


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


def test_nothing_that_was_moved_aside_is_ever_replaced(tmp_path):
    scene = tmp_path / "scenes" / "scene_0000000000.npz"
    harmed = []
    for place in (0.3, 0.5, 0.7):
        writer = SceneWriter(tmp_path, {"config": "test"})
        writer.add(made_record(0))
        writer.close()
        flip(scene, place)
        harmed.append(scene.read_bytes())
    SceneWriter(tmp_path, {"config": "test"}).close()
    kept = [path.read_bytes() for path in (tmp_path / "damaged" / "scenes").iterdir()]
    assert len(set(harmed)) == 3 and sorted(kept) == sorted(harmed)


def test_a_damaged_shard_of_attempts_names_them(tmp_path):
    """Attempts are numbered by their time in nanoseconds, with 19 digits."""
    times = (1_790_000_000_123_456_789, 1_790_000_000_123_456_790)
    writer = SceneWriter(tmp_path, {"config": "test"}, shard_size=2)
    for time in times:
        writer.add(made_record(time))
    writer.close()
    cut(tmp_path / "shards" / "shard_00000.npz")
    [finding] = (f for f in verify_dataset(tmp_path) if f.file.name == "shard_00000.npz")
    assert finding.lost and set(finding.lost) <= {f"scene_{time}" for time in times}
    assert finding.lost[0] in str(finding)


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


def test_scenes_are_not_begun_with_a_damaged_library(library, tmp_path):
    file = tmp_path / library.name
    shutil.copy(library, file)
    cut(file)
    run = Run(scenes_command(tmp_path / "data", file))
    assert run.ended() == 2 and f"{file} is damaged" in run.said()
    assert not (tmp_path / "data").exists()


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

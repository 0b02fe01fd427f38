"""Damaged grasp libraries: all files are named, moved aside on demand, and made anew by the same
command.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harms import cut, empty, flip
from made_library import made_library
from made_runs import GRIPPER, Run, grasps_command

from megrasp_core.cli import main
from megrasp_core.errors import DataError
from megrasp_core.library import load_library, pack_library, verify_library, write_grasp_set
from megrasp_core.storage import open_npz, write_npz


def told(capsys, *args: object) -> tuple[int, str]:
    capsys.readouterr()
    code = main([str(a) for a in ("data", "verify", *args)])
    return code, capsys.readouterr().out


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

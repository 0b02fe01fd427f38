"""The cache of rendered clouds and collision points."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from gripper_cases import slide_pair
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper, cache, load_gripper
from megrasp_core.grippers.cache import cache_folder, recalled


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("MEGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def files(folder: Path) -> list[Path]:
    """All files of the cache."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def everything(gripper: Gripper) -> list[NDArray]:
    """All that is cached of a gripper."""
    return [*vars(gripper.clouds(64, seed=2)).values(), *gripper.collision_points(0.02)]


def same(first: list[NDArray], second: list[NDArray]) -> bool:
    """Whether both are equal to the last bit and of the same types."""
    return all(
        a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        for a, b in zip(first, second, strict=True)
    )


class Counted:
    """A computation that counts how often it is done."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> dict[str, NDArray]:
        self.calls += 1
        return {"x": np.arange(12.0).reshape(4, 3)[:, ::-1], "n": np.array([3, 1], np.int64)}


def test_recalled_is_what_was_computed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit, and what is read is not computed again."""
    fresh = everything(load_gripper("franka_hand"))
    assert len(files(folder)) == 2
    monkeypatch.setattr("megrasp_core.grippers.gripper.make_clouds", None)
    monkeypatch.setattr("megrasp_core.grippers.gripper.surface_points", None)
    again = everything(load_gripper("franka_hand"))
    assert same(again, fresh)
    assert all(array.flags.writeable for array in again)
    monkeypatch.undo()
    monkeypatch.setenv("MEGRASP_CACHE", "off")
    assert same(everything(load_gripper("franka_hand")), fresh)
    assert len(files(folder)) == 2


def test_other_inputs_are_other_results(folder: Path, tmp_path: Path) -> None:
    """Seed, count, spacing, posture and geometry count; names and forces do not."""
    for name in ("one", "other", "wider"):
        (tmp_path / name).mkdir()
    gripper = slide_pair(tmp_path / "one")
    gripper.clouds(64, seed=1)
    Gripper.from_path(tmp_path / "one").clouds(64, seed=1)
    assert len(files(folder)) == 1
    gripper.clouds(64, seed=2)
    gripper.clouds(65, seed=1)
    gripper.collision_points(0.02)
    gripper.collision_points(0.03)
    assert len(files(folder)) == 5
    slide_pair(tmp_path / "other", open_left=0.01).clouds(64, seed=1)
    slide_pair(tmp_path / "wider", extra='<geom size="0.06 0.01 0.01"/>').clouds(64, seed=1)
    assert len(files(folder)) == 7
    text = (tmp_path / "one" / "gripper.yaml").read_text()
    (tmp_path / "one" / "gripper.yaml").write_text(text.replace("a test", "another test"))
    Gripper.from_path(tmp_path / "one").clouds(64, seed=1)
    assert len(files(folder)) == 7


@pytest.mark.parametrize("damage", ["empty", "short", "bit", "text", "folder"])
def test_damaged_files(folder: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    """They are computed again and replaced."""
    make = Counted()
    first = recalled("kind", (1, "a"), make)
    file = files(folder)[0]
    content = bytearray(file.read_bytes())
    if damage == "folder":
        file.unlink()
        (file / "inside").mkdir(parents=True)
    elif damage == "bit":
        content[-3] ^= 4
        file.write_bytes(content)
    else:
        file.write_bytes({"empty": b"", "short": content[:-1], "text": b"hello" * 99}[damage])
    assert same([*recalled("kind", (1, "a"), make).values()], [*first.values()])
    assert make.calls == 2
    recalled("kind", (1, "a"), make)
    assert make.calls == (3 if damage == "folder" else 2)
    assert any(record.levelno == logging.WARNING for record in caplog.records)
    assert [path.suffix for path in files(folder)] in ([".cache"], [])


def test_folder_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """One warning, and results all the same."""
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("MEGRASP_CACHE", str(tmp_path / "file" / "cache"))
    make = Counted()
    for _ in range(3):
        assert same([*recalled("kind", (1,), make).values()], [*make().values()])
    assert len(caplog.records) == 1 and "MEGRASP_CACHE" in caplog.text


def test_where_it_lies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """MEGRASP_CACHE, else XDG_CACHE_HOME, else the home folder; empty and off switch it off."""
    for value, expected in (
        (str(tmp_path), tmp_path), ("", None), ("off", None), (" OFF ", None),
        ("relative", Path.cwd() / "relative"),
    ):  # fmt: skip
        monkeypatch.setenv("MEGRASP_CACHE", value)
        assert cache_folder() == expected
    monkeypatch.delenv("MEGRASP_CACHE")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "xdg" / "megrasp"
    for value in ("", "not/absolute"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert cache_folder() == tmp_path / ".cache" / "megrasp"


def test_oldest_files_go_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder stays within its limit; what was read lately stays."""
    make = Counted()
    for index in range(20):
        recalled("kind", (index,), make)
        os.utime(max(files(folder), key=lambda file: file.stat().st_mtime), (index, index))
    size = files(folder)[0].stat().st_size
    monkeypatch.setattr(cache, "LIMIT", 10 * size)
    recalled("kind", (0,), make)
    calls = make.calls
    index = 100
    while len(files(folder)) > 10:
        recalled("kind", (index,), make)
        index += 1
        assert index < 400
    assert make.calls == calls + index - 100
    recalled("kind", (0,), make)
    assert make.calls == calls + index - 100
    recalled("kind", (1,), make)
    assert make.calls == calls + index - 100 + 1


WRITER = """
import numpy as np
from megrasp_core.grippers.cache import recalled
for _ in range(60):
    for index in range(3):
        made = recalled("kind", (index,), lambda: {"x": np.full(50_000, float(index))})
        assert (made["x"] == index).all() and len(made["x"]) == 50_000
"""


@pytest.mark.slow
def test_several_may_write_at_once(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Two processes and two threads meet only whole files, and leave nothing else behind."""
    others = [
        subprocess.Popen([sys.executable, "-c", WRITER], stderr=subprocess.PIPE) for _ in range(2)
    ]
    stop = threading.Event()

    def clear() -> None:
        while not stop.is_set():
            for file in files(folder):
                if file.suffix == ".cache":
                    file.unlink(missing_ok=True)

    thread = threading.Thread(target=clear)
    thread.start()
    try:
        exec(WRITER, {})
        assert [other.communicate(timeout=300)[1] for other in others] == [b"", b""]
        assert [other.returncode for other in others] == [0, 0]
    finally:
        stop.set()
        thread.join()
    assert not caplog.records
    assert not [file for file in files(folder) if file.suffix != ".cache"]

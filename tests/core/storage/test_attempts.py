"""Recorded attempts: they come back as they were, whatever happens to the cell or its disk."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from made_attempts import made_attempt

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.pointcloud import Plane
from megrasp_core.storage import AttemptFolder, DamagedError, read_attempt
from megrasp_core.storage.files import NpzFile, text_array, text_of, write_npz

SUPPORT = Path(__file__).parents[2] / "support"


def test_an_attempt_comes_back_as_it_was(tmp_path: Path) -> None:
    floor = Plane(np.array([0.0, 0.0, 1.0]), 0.002)
    given = made_attempt(
        7, success=False, reason="slipped", floor=floor, width=float("nan"), extra={"bin": 3}
    )
    path = AttemptFolder(tmp_path / "new").add(given)
    found = read_attempt(path)
    assert np.abs(found.points - given.points).max() < 6e-5
    for name in ("world_from_tcp", "world_from_gripper", "approach", "retreat"):
        assert np.allclose(getattr(found, name), getattr(given, name), atol=1e-9)
    assert np.array_equal(found.sensor, given.sensor)
    assert np.array_equal(found.gravity, given.gravity)
    assert found.region is not None and np.allclose(found.region.size, (0.4, 0.3, 0.2))
    assert found.floor is not None and found.floor.offset == 0.002
    assert np.isnan(found.width) and found.opening == 0.08
    plain = ("time", "gripper", "gripper_hash", "score", "seed", "model", "success", "reason")
    assert [getattr(found, name) for name in plain] == [getattr(given, name) for name in plain]
    assert found.extra == {"bin": 3}


def test_what_is_not_known_stays_unknown(tmp_path: Path) -> None:
    path = AttemptFolder(tmp_path).add(made_attempt(sensor=None, gravity=None, region=None))
    found = read_attempt(path)
    assert found.sensor is None and found.gravity is None and found.region is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"points": np.zeros((0, 3))}, r"points of shape \(0, 3\)"),
        ({"points": np.full((3, 3), np.nan)}, "not finite"),
        ({"world_from_tcp": np.zeros((4, 4))}, "world_from_tcp, which is no rigid"),
        ({"gravity": np.array([0.0, np.nan, 1.0])}, "gravity"),
        ({"score": 1.5}, "score 1.5"),
        ({"gripper_hash": ""}, "no gripper_hash"),
    ],
)
def test_nonsense_is_not_written(tmp_path: Path, change: dict, expected: str) -> None:
    folder = AttemptFolder(tmp_path)
    with pytest.raises(DataError, match=expected):
        folder.add(made_attempt(**change))
    assert not folder.paths


def test_two_at_the_same_time_are_both_kept(tmp_path: Path) -> None:
    folder = AttemptFolder(tmp_path)
    for score in (0.1, 0.2):
        folder.add(made_attempt(5, score=score))
    assert [attempt.score for attempt in folder.read_all([])] == [0.1, 0.2]


def test_the_oldest_go_when_the_folder_is_full(tmp_path: Path) -> None:
    size = AttemptFolder(tmp_path).add(made_attempt(1)).stat().st_size
    folder = AttemptFolder(tmp_path, limit=round(3.5 * size))
    for time in range(2, 8):
        folder.add(made_attempt(time))
    assert [attempt.time for attempt in folder.read_all([])] == [5, 6, 7]
    # One that is larger than everything allowed is kept all the same.
    AttemptFolder(tmp_path, limit=1).add(made_attempt(8))
    assert [attempt.time for attempt in folder.read_all([])] == [8]
    with pytest.raises(InvalidRequestError, match="limit of 0 bytes"):
        AttemptFolder(tmp_path, limit=0)


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def other_format(path: Path) -> None:
    rewritten(path, format=2)


def without_grip(path: Path) -> None:
    rewritten(path, gripper="")


def short_pose(path: Path) -> None:
    rewritten(path, world_from_tcp=[0.0] * 6)


def success_is_text(path: Path) -> None:
    rewritten(path, success="yes")


def rewritten(path: Path, **changes: object) -> None:
    with NpzFile(path) as file:
        arrays = {name: file[name] for name in file}
    meta = json.loads(text_of(arrays["meta"])) | changes
    write_npz(path, arrays | {"meta": text_array(json.dumps(meta))})


@pytest.mark.parametrize(
    ("harm", "expected"),
    [
        (truncated, "damaged"),
        (other_format, "format 1 is what"),
        (without_grip, "no gripper"),
        (short_pose, "world_from_tcp has 6 numbers"),
        (success_is_text, "success of another type"),
    ],
)
def test_a_damaged_one_is_left_out_with_a_note(tmp_path: Path, harm, expected: str) -> None:
    folder = AttemptFolder(tmp_path)
    paths = [folder.add(made_attempt(time)) for time in (1, 2, 3)]
    harm(paths[1])
    notes: list[str] = []
    assert [attempt.time for attempt in folder.read_all(notes)] == [1, 3]
    assert len(notes) == 1 and paths[1].name in notes[0] and expected in notes[0]
    with pytest.raises(DamagedError):
        read_attempt(paths[1])


def test_an_empty_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"holds no attempt_\*\.npz"):
        list(AttemptFolder(tmp_path / "nowhere").read_all([]))


WRITER = """
import sys
from made_attempts import made_attempt
from megrasp_core.grippers import load_gripper
from megrasp_core.storage import AttemptFolder
folder, gripper = AttemptFolder(sys.argv[1]), load_gripper("robotiq_2f85")
for time in range(int(sys.argv[2]), 10**6):
    folder.add(made_attempt(time, gripper=gripper))
    print(time, flush=True)
"""


def killed_while_writing(folder: Path, first: int, count: int) -> int:
    """Number of the last attempt that a process said it had written before it was killed."""
    environment = os.environ | {"PYTHONPATH": f"{SUPPORT}:{os.environ.get('PYTHONPATH', '')}"}
    run = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder), str(first)],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert run.stdout is not None
    lines = [run.stdout.readline() for _ in range(count)]
    # The next one is being made or written now.
    run.send_signal(signal.SIGKILL)
    lines += run.stdout.readlines()
    run.wait()
    return int([line for line in lines if line.endswith("\n")][-1])


def test_a_killed_cell_loses_nothing_that_was_written(tmp_path: Path) -> None:
    first = 1
    for count in (3, 7):
        last = killed_while_writing(tmp_path, first, count)
        notes: list[str] = []
        times = [attempt.time for attempt in AttemptFolder(tmp_path).read_all(notes)]
        # Perhaps one more, that was finished and not yet told.
        assert times in (list(range(1, last + 1)), list(range(1, last + 2)))
        assert not notes
        first = times[-1] + 1


def test_what_a_killed_cell_left_half_written_is_no_attempt_and_goes(tmp_path: Path) -> None:
    folder = AttemptFolder(tmp_path)
    whole = folder.add(made_attempt(1)).read_bytes()
    half = tmp_path / ".attempt_00000000000000000002.npz.4711.part"
    half.write_bytes(whole[: len(whole) // 2])
    assert [attempt.time for attempt in folder.read_all([])] == [1]
    AttemptFolder(tmp_path)
    assert half.exists(), "it may be another process's at work"
    os.utime(half, (0, 0))
    AttemptFolder(tmp_path)
    assert not half.exists()


def test_every_field_is_kept() -> None:
    """A new field has to be written, too."""
    from megrasp_core.storage import attempts

    kept = {*attempts.PLAIN, *attempts.POSES}
    kept |= {"points", "sensor", "gravity", "region", "floor", "extra"}
    assert kept == {each.name for each in dataclasses.fields(attempts.Attempt)}

"""Real accidents to the real command: kills, signals, full disks. Nothing finished is lost, the
same command goes on, and the data set is in the end what it would have been.
"""

from __future__ import annotations

import os
import signal
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from made_runs import NO_DISK, SCENES, Run, alive, contents, scenes_command, until

from megrasp_core.cli import main
from megrasp_core.errors import DataError
from megrasp_core.storage import SceneDataset


@pytest.fixture(scope="module")
def undisturbed(library: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """The data set as it is without any accident."""
    folder = tmp_path_factory.mktemp("undisturbed")
    run = Run(scenes_command(folder / "data", library))
    assert run.ended() == 0, run.said()
    found = contents(folder / "data")
    assert len(found) == SCENES
    return found


def finished(folder: Path) -> int:
    """Scenes that a reader finds now."""
    try:
        return len(SceneDataset(folder).names)
    except (DataError, OSError):
        return 0


def assert_goes_on(out: Path, library: Path, undisturbed: dict) -> str:
    """The same command completes the data set; what it said."""
    assert main(["data", "verify", "--out", str(out)]) == 0
    run = Run(scenes_command(out, library))
    assert run.ended() == 0, run.said()
    assert contents(out) == undisturbed
    assert main(["data", "verify", "--out", str(out)]) == 0
    held = Counter(path.stem for path in (out / "scenes").glob("*"))
    for shard in (out / "shards").glob("*"):
        held.update({key.split("/")[0] for key in np.load(shard).files if "/" in key})
    assert set(held.values()) == {1}, "every scene lies in one file, and nothing is left over"
    return run.said()


@pytest.mark.parametrize(
    ("death", "left"),
    [
        (("replace", ".scene_*.part", 6), 5),
        (("replace", ".shard_*.part", 1), 4),
        (("unlink", "scene_*.npz", 1), 4),
        (("unlink", "scene_*.npz", 7), 8),
        (("replace", ".manifest*.part", 2), 4),
    ],
    ids=["a scene", "a shard", "before deleting", "while deleting", "the manifest"],
)
def test_killed_while_it_writes(death, left, library, undisturbed, tmp_path):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library), death=death)
    assert run.ended() == -signal.SIGKILL, run.said()
    assert finished(out) == left, "all that was finished is there"
    assert_goes_on(out, library, undisturbed)


def test_killed_with_workers_it_leaves_no_process_behind(library, undisturbed, tmp_path):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library, workers=2), pace=0.2)
    until(lambda: finished(out) >= 3)
    workers = run.workers()
    assert len(workers) == 2
    os.kill(run.pid, signal.SIGKILL)
    assert run.ended() == -signal.SIGKILL
    assert 3 <= finished(out) < SCENES
    try:
        until(lambda: not any(alive(pid) for pid in workers), seconds=20)
    finally:
        for pid in filter(alive, workers):
            os.kill(pid, signal.SIGKILL)
    assert_goes_on(out, library, undisturbed)


def test_a_killed_worker_costs_nothing(library, undisturbed, tmp_path):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library, workers=2), pace=0.2)
    until(lambda: finished(out) >= 3)
    os.kill(run.workers()[0], signal.SIGKILL)
    assert run.ended() == 0, run.said()
    assert f"{SCENES} scenes" in run.said() and " 0 failed" in run.said()
    assert contents(out) == undisturbed


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_run_and_keep_what_is_done(
    number, workers, library, undisturbed, tmp_path
):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library, workers), pace=0.2)
    until(lambda: finished(out) >= 3)
    busy = run.workers()
    assert len(busy) == (2 if workers == 2 else 0)
    # As a terminal does, and batch systems do: to every process of the group.
    os.killpg(run.pid, number)
    assert run.ended(20) == 1, run.said()
    name = "Ctrl-C" if number == signal.SIGINT else "SIGTERM"
    assert f"stopped: {name}" in run.said() and "same command again" in run.said()
    assert "Traceback" not in run.said(), run.said()
    kept = finished(out)
    assert f"{kept} scenes in" in run.said() and 3 <= kept < SCENES
    until(lambda: not any(alive(pid) for pid in busy), seconds=20)
    assert_goes_on(out, library, undisturbed)


def test_no_room_for_a_shard_leaves_its_scenes_as_they_are(library, undisturbed, tmp_path):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library), limit=8000)
    assert run.ended() == 0, run.said()
    assert "no shard was made" in run.said() and "File too large" in run.said()
    assert not list((out / "shards").iterdir()) and contents(out) == undisturbed


def test_no_room_for_a_scene_ends_the_run(library, undisturbed, tmp_path):
    out = tmp_path / "data"
    command = scenes_command(out, library)
    command[command.index("-n") + 1] = "5"
    assert Run(command).ended() == 0
    before = {path: path.read_bytes() for path in (out / "shards").iterdir()}
    run = Run(scenes_command(out, library), limit=2500)
    assert run.ended() == 1, run.said()
    assert "0 scenes in" in run.said() and "2 failed" in run.said()
    assert "File too large" in run.said() and "scene_0000000005.npz" in run.said()
    assert "stopped: 2 results in a row could not be written; make room" in run.said()
    assert "same command again" in run.said() and "Traceback" not in run.said()
    assert finished(out) == 5 and not list(out.rglob(".*.part"))
    assert before == {path: path.read_bytes() for path in (out / "shards").iterdir()}
    assert_goes_on(out, library, undisturbed)


def test_no_room_for_the_manifest_ends_the_run_before_it_starts(library, undisturbed, tmp_path):
    out = tmp_path / "data"
    run = Run(scenes_command(out, library), limit=400)
    assert run.ended() == 2, run.said()
    assert "File too large" in run.said() and "manifest.json" in run.said()
    assert "Traceback" not in run.said()
    run = Run(scenes_command(out, library))
    assert run.ended() == 0 and contents(out) == undisturbed


def test_a_full_disk(library, undisturbed, tmp_path):
    """A file system of 32 kB, mounted for the run alone."""
    out = tmp_path / "disk" / "data"
    out.parent.mkdir()
    run = Run(scenes_command(out, library), disk=(out.parent, "32k", tmp_path / "copy"))
    if run.ended() == NO_DISK:
        pytest.skip(f"a small file system cannot be mounted here: {run.said().strip()}")
    assert run.ended() == 1 and not out.exists()
    said, saved = run.said(), tmp_path / "copy" / "data"
    assert "No space left on device" in said and "make room on the disk" in said
    assert "same command again" in said and "Traceback" not in said
    kept = finished(saved)
    assert 3 <= kept < SCENES and f"{kept} scenes in" in said
    assert not list(saved.rglob(".*.part"))
    assert_goes_on(saved, library, undisturbed)

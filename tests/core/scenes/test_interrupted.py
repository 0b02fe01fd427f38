"""The data generator on real physics, interrupted as users and batch systems do: what comes out in
the end is what an undisturbed run makes, bit for bit.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from megrasp_core.cli import main
from megrasp_core.library import LabelSettings, LibraryConfig, generate_library
from megrasp_core.objects import training_objects
from megrasp_core.scenes import SceneConfig, SceneJob, generate_scenes
from megrasp_core.storage import SceneDataset, verify_dataset
from megrasp_core.storage.scene_dataset import record_arrays

pytestmark = pytest.mark.slow

GRIPPER = "robotiq_2f85"
OBJECTS = training_objects(6, assets=False)
COMMON = ("--gripper", GRIPPER, "--procedural", "6", "--no-assets")


def start(*command: str) -> subprocess.Popen[str]:
    """`megrasp data ...` at the head of a process group, as a shell starts it."""
    code = "import sys; from megrasp_core.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, "data", *command, *COMMON],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def wait_for(run: subprocess.Popen[str], folder: Path, pattern: str) -> None:
    """Until the first file is there."""
    end = time.monotonic() + 300
    while not list(folder.glob(pattern)):
        assert run.poll() is None and time.monotonic() < end, run.communicate()[0]
        time.sleep(0.01)


def assert_gone(group: int) -> None:
    """No process of the group is left, after a moment for those that just ended."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError(f"processes of the group {group} are left")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six pairs made undisturbed."""
    folder = tmp_path_factory.mktemp("library")
    config = LibraryConfig((GRIPPER,), OBJECTS, settings=LabelSettings(target=3))
    assert generate_library(folder, config).done == 6
    return folder


@pytest.mark.slow
def test_a_library_terminated_on_the_way(library, tmp_path):
    out = tmp_path / "library"
    command = ("grasps", "--out", str(out), "--target", "3")
    run = start(*command)
    wait_for(run, out / GRIPPER, "*.npz")
    os.killpg(run.pid, signal.SIGTERM)
    said = run.communicate(timeout=60)[0]
    kept = sorted(path.name for path in (out / GRIPPER).iterdir())
    assert run.returncode == 1 and 1 <= len(kept) < 6, said
    assert f"{len(kept)} pairs" in said and "stopped: SIGTERM" in said
    assert "Traceback" not in said
    stamps = {name: (out / GRIPPER / name).stat().st_mtime_ns for name in kept}
    assert main(["data", *command, *COMMON]) == 0
    assert stamps == {name: (out / GRIPPER / name).stat().st_mtime_ns for name in kept}
    assert {path.name: path.read_bytes() for path in (out / GRIPPER).iterdir()} == {
        path.name: path.read_bytes() for path in (library / GRIPPER).iterdir()
    }


@pytest.mark.slow
def test_scenes_of_two_workers_stopped_by_ctrl_c(library, tmp_path):
    out, seeds = tmp_path / "scenes", range(4)
    run = start(
        *("scenes", "--out", str(out), "--library", str(library)),
        *("-n", str(len(seeds)), "--workers", "2"),
    )
    wait_for(run, out / "scenes", "scene_*.npz")
    os.killpg(run.pid, signal.SIGINT)
    said = run.communicate(timeout=60)[0]
    kept = len(SceneDataset(out))
    assert run.returncode == 1 and 1 <= kept < len(seeds), said
    assert f"{kept} scenes in" in said and "stopped: Ctrl-C" in said
    assert "Traceback" not in said
    assert_gone(run.pid)
    job = SceneJob(SceneConfig(grippers=(GRIPPER,)), library, OBJECTS)
    assert generate_scenes(out, job, seeds).done == len(seeds) - kept
    generate_scenes(tmp_path / "undisturbed", job, seeds)
    assert verify_dataset(out) == []
    found, expected = (
        [{k: v.tobytes() for k, v in record_arrays(one).items()} for one in SceneDataset(folder)]
        for folder in (out, tmp_path / "undisturbed")
    )
    assert found == expected and len(found) == len(seeds)

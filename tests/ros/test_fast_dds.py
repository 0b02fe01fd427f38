"""Shared memory and profiles of Fast DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from cell_processes import WAIT, own_domain, processes, until

from megrasp_ros.fast_dds import (
    BUFFER,
    ENOUGH,
    FOLDER,
    LARGE,
    LEAST,
    SMALL_BUFFERS,
    SMALL_MEMORY,
    profile,
    remove_stale_segments,
    shared_memory_warning,
)

CONFIG = Path(get_package_share_directory("megrasp_bringup")) / "config"
OLD = time.time() - 3600.0


def test_the_profile_fits_the_machine() -> None:
    assert profile(ENOUGH, BUFFER) == LARGE
    assert profile(ENOUGH, BUFFER - 1) == SMALL_BUFFERS
    assert profile(64 * 2**20, BUFFER) == SMALL_MEMORY
    for name in (LARGE, SMALL_BUFFERS, SMALL_MEMORY):
        assert (CONFIG / name).is_file()
    command = [sys.executable, "-m", "megrasp_ros.fast_dds", str(CONFIG)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert Path(told.strip()).is_file() and Path(told.strip()).name == profile()


def test_small_shared_memory_is_told() -> None:
    assert not shared_memory_warning(ENOUGH, LARGE)
    text = shared_memory_warning(64 * 2**20, LARGE)
    assert "64 MiB" in text and "--shm-size" in text and SMALL_MEMORY in text
    assert not shared_memory_warning(64 * 2**20, f"/anywhere/{SMALL_MEMORY}")
    assert f"expected {LEAST / 2**20:.0f}" in shared_memory_warning(2**20, SMALL_MEMORY)


def test_only_what_nobody_holds_is_removed(tmp_path: Path) -> None:
    def segment(name: str, *, age: float = 3600.0) -> Path:
        for file in (tmp_path / name, tmp_path / f"{name}_el"):
            file.write_bytes(b"x" * 100)
            os.utime(file, (time.time() - age,) * 2)
        return tmp_path / name

    stale, held = segment("fastrtps_0123456789abcdef"), segment("fastrtps_fedcba9876543210")
    new = segment("fastrtps_aaaaaaaaaaaaaaaa", age=0.0)
    port = segment("fastrtps_port7411")
    other = segment("something_else")
    # The lock of another process.
    holding = "import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_EX); print(1)"
    command = [sys.executable, "-c", f"{holding}; sys.stdout.flush(); sys.stdin.read()"]
    holder = subprocess.Popen(
        [*command, f"{held}_el"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None and holder.stdout.readline()
    try:
        assert remove_stale_segments(tmp_path) == 100
    finally:
        holder.communicate(b"")
    assert not stale.exists() and not Path(f"{stale}_el").exists()
    assert all(file.exists() for file in (held, new, port, other))
    assert remove_stale_segments(tmp_path / "nowhere") == 0


@pytest.mark.skipif(not FOLDER.is_dir(), reason="no shared memory")
def test_a_killed_node_leaves_nothing_once_another_starts(tmp_path: Path) -> None:
    with processes(own_domain(2), tmp_path) as running:
        node = running.start("tool_changer")

        def mapped() -> set[str]:
            lines = Path(f"/proc/{node.pid}/maps").read_text().splitlines()
            return {each.split()[5] for each in lines if "/dev/shm/fastrtps_" in each}

        def segments() -> list[Path]:
            return [Path(each) for each in mapped() if "port" not in each]

        assert until(lambda: bool(segments()), WAIT)
        left = segments()
        # Nobody takes them from a living node.
        for each in left:
            os.utime(f"{each}_el", (OLD, OLD))
        remove_stale_segments()
        assert all(each.exists() for each in left)
        running.stop("tool_changer", signal.SIGKILL)
        assert any(each.exists() for each in left)
        running.start("tool_changer")
        assert until(lambda: not any(each.exists() for each in left), WAIT)

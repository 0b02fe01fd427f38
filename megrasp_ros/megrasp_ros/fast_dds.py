"""What Fast DDS needs of the machine for clouds of 5 MB: shared memory, large UDP buffers, and a
profile that fits what there is.

python -m megrasp_ros.fast_dds launch_scripts/config

prints the path of the profile; env.sh and the launch files ask it.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import sys
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
ENOUGH = 256 * 2**20
"""Bytes of shared memory for a cell with several processes, each with a segment of 34 MB."""

LEAST = 56 * 2**20
"""Bytes for four processes with segments of 13 MB, those of `SMALL_MEMORY`."""

BUFFER = 4 * 2**20
"""UDP buffers (bytes) that `LARGE` asks for; asking for more than the kernel grants stops the
discovery of Fast DDS."""

LIMITS = (Path("/proc/sys/net/core/rmem_max"), Path("/proc/sys/net/core/wmem_max"))

LARGE = "fastdds.xml"
SMALL_BUFFERS = "fastdds_small_buffers.xml"
SMALL_MEMORY = "fastdds_small_memory.xml"

_SEGMENT = re.compile(r"fastrtps_[0-9a-f]{16}")
_NEW = 10.0
"""A segment so young (s) may belong to a process that has not locked it yet."""


def profile(memory: int | None = None, buffers: int | None = None) -> str:
    """Return the file of the profile for this machine.

    Args:
        memory: size of the shared memory in bytes, and
        buffers: largest UDP buffer that the kernel grants; by default this machine's.
    """
    memory = _shared_memory() if memory is None else memory
    buffers = _largest_buffer() if buffers is None else buffers
    if memory < ENOUGH:
        return SMALL_MEMORY
    return LARGE if buffers >= BUFFER else SMALL_BUFFERS


def shared_memory_warning(memory: int | None = None, in_use: str | None = None) -> str:
    """Return what is to be changed where shared memory is too small for clouds of 5 MB, "" where
    it is not.

    Args:
        memory: its size in bytes, by default this machine's.
        in_use: path of the profile, by default the one that Fast DDS is told to read.
    """
    memory = _shared_memory() if memory is None else memory
    if in_use is None:
        in_use = os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    needed = LEAST if Path(in_use).name == SMALL_MEMORY else ENOUGH
    if memory >= needed:
        return ""
    return (
        f"{FOLDER} holds {memory / 2**20:.0f} MiB; expected {needed / 2**20:.0f} for clouds of 5 "
        "MB, many of which get lost otherwise. Give a container more, for instance docker run "
        "--shm-size=512m or --ipc=host"
        + (
            f", or set FASTRTPS_DEFAULT_PROFILES_FILE to {SMALL_MEMORY} of launch_scripts/config "
            "in every process, which env.sh and the launch files do."
            if needed == ENOUGH
            else "."
        )
    )


def remove_stale_segments(folder: Path = FOLDER) -> int:
    """Remove what processes of this user that were killed have left in shared memory; return its
    size in bytes.

    A living process holds a lock on the file beside its segment, so nothing of it is touched.
    """
    freed = 0
    for lock in sorted(folder.glob("fastrtps_*_el")) if folder.is_dir() else ():
        segment = lock.with_name(lock.name.removesuffix("_el"))
        if not _SEGMENT.fullmatch(segment.name):
            continue
        try:
            described = lock.stat()
            if described.st_uid != os.geteuid() or time.time() - described.st_mtime < _NEW:
                continue
            with lock.open() as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if segment.exists():
                    freed += segment.stat().st_size
                    segment.unlink()
                lock.unlink()
        except OSError:
            # Held, or another node was quicker.
            continue
    return freed


def _shared_memory() -> int:
    return shutil.disk_usage(FOLDER).total if FOLDER.is_dir() else ENOUGH


def _largest_buffer() -> int:
    return min((int(file.read_text()) for file in LIMITS if file.is_file()), default=BUFFER)


if __name__ == "__main__":
    sys.stdout.write(f"{Path(sys.argv[1]).resolve() / profile()}\n")

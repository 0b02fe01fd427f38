"""Whether clouds fit the shared memory that Fast DDS passes them through."""

from __future__ import annotations

import shutil
from pathlib import Path

FOLDER = Path("/dev/shm")
ENOUGH = 256 * 2**20
"""Each process takes a segment of 34 MB (launch_scripts/config), and a cell has several."""


def shared_memory_warning(folder: Path = FOLDER, total: int | None = None) -> str:
    """Return what is to be changed where shared memory is small, "" where it is not.

    total: its size in bytes, by default that of `folder`.
    """
    if total is None:
        if not folder.is_dir():
            return ""
        total = shutil.disk_usage(folder).total
    if total >= ENOUGH:
        return ""
    return (
        f"{folder} holds {total / 2**20:.0f} MiB; expected {ENOUGH / 2**20:.0f} for clouds of 5 "
        "MB, many of which get lost otherwise. Give a container more, for instance docker run "
        "--shm-size=512m or --ipc=host, or set FASTRTPS_DEFAULT_PROFILES_FILE to a profile "
        "without shared memory."
    )

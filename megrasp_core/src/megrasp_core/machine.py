"""The machine that something runs on: its processor, and whether its memory is full."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any


def processor() -> dict[str, Any]:
    """Name of the processor and the number of cores that this process may use."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        name = lines[0].split(":", 1)[1].strip() if lines else name
    return {"cpu": name, "cores": len(os.sched_getaffinity(0))}


_NO_MEMORY = ("can't allocate memory", "out of memory", "STATUS_ALLOC_FAILED")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the memory of the machine, or of its GPU, was not enough.

    torch has a class of its own for that only on GPUs, and there not everywhere.
    """
    if isinstance(error, MemoryError):
        return True
    return isinstance(error, RuntimeError) and (
        # By name, so that what never computes need not import torch.
        type(error).__name__ == "OutOfMemoryError"
        or any(words in str(error) for words in _NO_MEMORY)
    )

"""What every run of the generator was and took, beside its data: `runs.jsonl`, one line a run.

It is what says with which seed, effort and versions a library was made, and how long scenes take.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from megrasp_core.machine import processor

from .executors import ExecutorConfig, RunSummary

NAME = "runs.jsonl"


def versions() -> dict[str, str]:
    """Versions of what decides on the data."""
    return {name: importlib.metadata.version(name) for name in ("megrasp-core", "mujoco", "numpy")}


def code_hash(package: Path) -> str:
    """16 hex digits of all Python files below a folder: other code, other results."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def log_run(
    folder: Path,
    executor: ExecutorConfig | None,
    summary: RunSummary,
    made_with: dict[str, Any] | None = None,
) -> None:
    """Adds the line of a run that did anything.

    CPU-seconds are those of the units, wherever they ran; writing is not in them.

    Args:
        folder: of the data.
        executor: where it ran.
        summary: what was done.
        made_with: seed and settings, where no manifest keeps them.
    """
    executor = executor or ExecutorConfig()
    if not summary.done:
        return
    line = {
        "done": summary.done,
        "failed": len(summary.failed),
        "seconds": round(summary.seconds, 1),
        "cpu_seconds": round(summary.cpu_seconds, 1),
        "executor": executor.kind,
        "workers": executor.workers,
        **processor(),
        "versions": versions(),
        **(made_with or {}),
    }
    add_runs(folder, [line])


def add_runs(folder: Path, runs: list[dict[str, Any]]) -> None:
    """Adds the lines of runs that `runs.jsonl` of the folder does not hold yet."""
    known = runs_of(folder)
    new = [json.dumps(run) + "\n" for run in runs if run not in known]
    # The data is what counts, and a full disk was told of when it was written.
    with suppress(OSError), (folder / NAME).open("a") as file:
        file.write("".join(new))


def runs_of(folder: Path) -> list[dict[str, Any]]:
    """The runs that made the data of a folder; none where nobody kept them.

    A line that a kill cut short is left out.
    """
    return list(_lines(folder / NAME))


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    if path.is_file():
        for line in path.read_text(errors="replace").splitlines():
            with suppress(ValueError):
                yield json.loads(line)

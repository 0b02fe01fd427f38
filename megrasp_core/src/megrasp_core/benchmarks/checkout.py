"""Older checkouts that a benchmark compares with."""

from __future__ import annotations

import subprocess
from pathlib import Path

from megrasp_core.errors import InvalidRequestError

PRESENT = Path(__file__).resolve().parents[2]
"""The folder that holds the package that runs."""


def commit_of(checkout: Path) -> str:
    """Short hash of a checkout's commit, or "unknown"."""
    done = subprocess.run(
        ["git", "-C", str(checkout), "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
    )
    return done.stdout.strip() or "unknown"


def package_of(checkout: Path) -> Path:
    """The folder of a checkout that holds the package.

    Raises:
        InvalidRequestError: it holds none.
    """
    source = checkout / "megrasp_core" / "src"
    if not (source / "megrasp_core").is_dir():
        raise InvalidRequestError(
            f"{checkout} holds no megrasp_core/src; expected a checkout of an older commit. Make "
            "one with `git worktree add DIR COMMIT`."
        )
    return source


def trains_as_now(source: Path) -> bool:
    """Whether the package in a folder has today's way to train, or that of 1540005."""
    return (source / "megrasp_core" / "training" / "processes.py").exists()

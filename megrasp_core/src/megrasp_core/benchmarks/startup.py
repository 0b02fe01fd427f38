"""CPU-seconds until a command can begin, beside those of an older checkout in one run (`megrasp
bench --stage startup`).
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.machine import processor

from .checkout import commit_of

__all__ = ["bench_startup", "startup_table"]

PROGRAMS = {
    "megrasp --help": "from megrasp_core.cli import main; main(['--help'])",
    "megrasp synthesize, without synthesis": (
        "from megrasp_core.cli import main\n"
        "from megrasp_core.synthesizer import GraspSynthesizer\n"
        "GraspSynthesizer.load(gripper='robotiq_2f85')"
    ),
    "import torch": "import torch",
}
GOALS = {"megrasp --help": 0.5, "megrasp synthesize, without synthesis": 3.5}
"""CPU-seconds on a quiet machine."""


def bench_startup(
    against: Path,
    *,
    repeats: int = 5,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Time starts of this package and of an older checkout by turns, in this Python.

    Args:
        against: checkout to compare with.
        repeats: rounds, after one that is not counted; the least of the rounds counts.
        on_progress: called with starts done and in all.

    Returns:
        Content of the result file: CPU-seconds of both and their ratio; `import torch` tells how
        much of it nobody can save.

    Raises:
        InvalidRequestError: `against` is no checkout.
        DataError: a program failed.
    """
    root = Path(__file__).resolve().parents[4]
    trees = {"before": against, "now": root}
    for name, tree in trees.items():
        if not (tree / "megrasp_core" / "src" / "megrasp_core").is_dir():
            raise InvalidRequestError(
                f"{tree} holds no megrasp_core/src; expected a checkout ({name}). Make one with "
                "`git worktree add DIR COMMIT`."
            )
    taken: dict[str, dict[str, list[float]]] = {
        what: {name: [] for name in trees} for what in PROGRAMS
    }
    total, done = (repeats + 1) * len(PROGRAMS) * len(trees), 0
    for repeat in range(repeats + 1):
        for what, program in PROGRAMS.items():
            for name, tree in trees.items():
                seconds = _cpu_seconds(program, tree)
                if repeat:
                    taken[what][name].append(seconds)
                done += 1
                if on_progress is not None:
                    on_progress(done, total)
    rows = []
    for what, found in taken.items():
        before, now = min(found["before"]), min(found["now"])
        rows.append(
            {
                "what": what,
                "before": round(before, 3),
                "now": round(now, 3),
                "ratio": round(now / before, 3),
                "goal": GOALS.get(what),
            }
        )
    return {
        "stage": "startup",
        "against": commit_of(against),
        "repeats": repeats,
        "cpu_seconds": rows,
        "hardware": processor(),
        "load": round(os.getloadavg()[0], 1),
    }


def startup_table(content: dict[str, Any]) -> str:
    """The result as markdown."""
    lines = [
        "| CPU-seconds | before | now | ratio | goal |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in content["cpu_seconds"]:
        goal = "" if row["goal"] is None else f"{row['goal']:g}"
        lines.append(
            f"| `{row['what']}` | {row['before']:.2f} | {row['now']:.2f} | {row['ratio']:.2f} | "
            f"{goal} |"
        )
    lines += [
        "",
        f"Least of {content['repeats']} starts each, by turns, before: {content['against']}. "
        f"{content['hardware']['cpu']}, load {content['load']:g} on "
        f"{content['hardware']['cores']} cores.",
    ]
    return "\n".join(lines) + "\n"


def _cpu_seconds(program: str, tree: Path) -> float:
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree / "megrasp_core" / "src"),
        "MEGRASP_MODELS": str(tree / "models"),
    }
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise DataError(
            f"a start in {tree} failed: {done.stderr.strip().splitlines()[-1:]}; expected "
            f"{program!r} to run."
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

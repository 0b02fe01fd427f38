"""What the commands share that run units of work: where they run, the bar, how they end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from .common import progress_bar, say

if TYPE_CHECKING:
    from megrasp_core.jobs import ExecutorConfig, Progress, RunSummary

__all__ = ["Executor", "executor_of", "finished", "run_bar"]

Executor = Literal["local", "ray"]


def executor_of(kind: Executor, address: str | None, workers: int) -> ExecutorConfig:
    """Where to run."""
    from megrasp_core.jobs import ExecutorConfig

    return ExecutorConfig(kind, workers, address)


@contextmanager
def run_bar(what: str) -> Iterator[Callable[[Progress], None]]:
    """A bar that a run moves by calling what is yielded."""
    with progress_bar(None, what) as bar:

        def tell(progress: Progress) -> None:
            bar.total = progress.total
            bar.n = progress.done + progress.failed
            bar.set_postfix(failed=progress.failed, refresh=True)

        yield tell


def finished(summary: RunSummary, what: str, out: Path) -> int:
    """Says what a run did, and returns the exit code."""
    say(f"{summary.done} {what} in {summary.seconds:.0f} s, {len(summary.failed)} failed; {out}")
    for unit, message in summary.failed[:10]:
        say(f"failed: {unit}: {message}")
    if summary.cancelled:
        say(f"stopped: {summary.reason}")
        say("what is counted here is saved; run the same command again to go on")
        return 1
    return 1 if summary.failed and not summary.done else 0

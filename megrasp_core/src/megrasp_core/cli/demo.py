"""`megrasp demo`."""

from __future__ import annotations

from pathlib import Path

from .common import emit, say

__all__ = ["demo"]


def demo(
    gripper: tuple[str, ...] = ("robotiq_2f85", "robotiq_3f"),
    objects: int = 8,
    picture: Path | None = None,
    model: str | None = None,
    device: str = "cpu",
    threads: int | None = None,
    seed: int = 1,
    out: Path | None = None,
) -> int:
    """Empty a simulated bin, without ROS.

    Prints a line per pick and a summary.

    Try: megrasp demo --gripper robotiq_2f85 --objects 8 --picture demo.png

    Args:
        gripper: names or folders, used in this order for equal shares of the objects.
        objects: procedural objects in the bin.
        picture: PNG with all picks; one picture per pick goes into a folder beside it.
        model: id or folder; the default for the kind of the gripper without it.
        device: cpu or cuda.
        threads: torch threads; as the process has them without it.
        seed: of the objects and the samples.
        out: JSON with the summary and every pick.
    """
    from megrasp_core.cell.demo import run_demo

    summary = run_demo(
        grippers=gripper,
        objects=objects,
        seed=seed,
        model=model,
        device=device,
        threads=threads,
        picture=picture,
        on_pick=lambda record: say(record.line()),
    )
    removed = summary["removed"]
    count = len(removed) if isinstance(removed, list) else 0
    say(
        f"removed {count} of {summary['objects_at_start']} objects in {summary['attempts']} "
        f"attempts, {summary['successes']} successful; {summary['ended']}"
    )
    if picture is not None:
        say(f"wrote {picture}")
    if out is not None:
        emit(summary, out)
    return 0 if count else 1

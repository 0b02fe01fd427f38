"""`megrasp data robust`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from megrasp_core.cli.common import progress_bar, say
from megrasp_core.cli.runs import Executor, executor_of, finished, run_bar
from megrasp_core.errors import InvalidRequestError

__all__ = ["robust"]


def robust(
    data: tuple[Path, ...],
    out: Path,
    num_grasps: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None,
    successes: int = 3,
    near_misses: int = 2,
    failures: int = 1,
    vary: tuple[Literal["pose", "friction", "mass", "force"], ...] = (
        "pose",
        "friction",
        "mass",
        "force",
    ),
    executor: Executor = "local",
    address: str | None = None,
    workers: int = 1,
    seed: int = 0,
) -> int:
    """Try grasps of labelled scenes four times again, each time with another pose, friction, mass
    and force; how often each held is what a confidence is trained with.

    A data set that exists is continued, also with more grasps or further folders; the same seed
    gives the same labels. Scans are looked for under MEGRASP_ASSETS.

    Try:
      megrasp data robust --data data/scenes --out data/robust -n 20000 --workers 2
      megrasp data stats --data data/robust

    Args:
        data: folders of `data scenes`, `samples`, `rollouts` or `render`.
        out: folder for the copies of the scenes that hold the new labels.
        num_grasps: take scenes until they have so many grasps; all without it.
        successes: grasps that held in the heap, a gripper and scene.
        near_misses: successes moved by 2 to 10 mm and 0.05 to 0.3 rad, a gripper and scene.
        failures: grasps that failed in the heap, a gripper and scene.
        vary: what differs from trial to trial; to see what breaks grasps, name one.
        executor: local processes or a Ray cluster.
        address: of the Ray cluster.
        workers: processes or tasks in flight.
        seed: of the choice of scenes and grasps, and of all draws.
    """
    if not data:
        raise InvalidRequestError("--data names nothing; expected folders of labelled scenes.")
    if num_grasps is not None and num_grasps < 1:
        raise InvalidRequestError(f"--num-grasps {num_grasps} was given; expected at least 1.")
    amounts = {"successes": successes, "near-misses": near_misses, "failures": failures}
    for name, value in {**amounts, "seed": seed}.items():
        if value < 0:
            raise InvalidRequestError(f"--{name} {value} was given; expected 0 or more.")
    if not any(amounts.values()):
        raise InvalidRequestError(
            "--successes, --near-misses and --failures are all 0; expected something to try."
        )
    from megrasp_core.scenes import RobustSettings, generate_robust

    settings = RobustSettings(successes, near_misses, failures, vary)
    with progress_bar(None, "looking through scenes") as bar:

        def read(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        with run_bar("robust") as tell:
            summary, grasps = generate_robust(
                data,
                out,
                settings,
                executor_of(executor, address, workers),
                grasps=num_grasps,
                seed=seed,
                on_read=read,
                on_progress=tell,
            )
    if grasps:
        say(f"{grasps} grasps, {summary.cpu_seconds / grasps:.2f} CPU-s each")
    return finished(summary, "scenes", out)

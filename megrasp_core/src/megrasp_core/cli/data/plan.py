"""`megrasp data plan`: how long a large data set takes on how many cores."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.cli.common import block_writer, emit, say
from megrasp_core.errors import DataError, InvalidRequestError

__all__ = ["plan"]


def plan(
    rates: Path,
    scenes_from: Path,
    objects: int = 1000,
    grippers: int = 13,
    successes: int = 5000,
    scenes: int = 25_000,
    cores: tuple[int, ...] = (16, 256, 1500),
    out: Path | None = None,
    page: Path | None = None,
) -> int:
    """Core-hours of a grasp library and of scenes, from rates measured before.

    Try: megrasp bench --stage data --out rates.json
         megrasp data stats --out data/scenes > scenes.json
         megrasp data plan --rates rates.json --scenes-from scenes.json --cores 16 256

    Args:
        rates: result file of `megrasp bench --stage data`.
        scenes_from: what `megrasp data stats` printed of a scene data set that was made here.
        objects: of the library.
        grippers: of the library.
        successes: of each object and gripper.
        scenes: of the scene data set.
        cores: numbers of cores to divide by.
        out: result file (JSON); by default printed.
        page: markdown page whose lines between <!-- plan --> and <!-- /plan --> become the table.
    """
    from megrasp_core.benchmarks.data_plan import plan_data, plan_table
    from megrasp_core.storage import read_json

    wrong = [n for n in (objects, grippers, successes, scenes, *cores) if n < 1]
    if wrong or not cores:
        raise InvalidRequestError(
            f"{wrong or 'no number of cores'} was given; expected whole numbers of at least 1."
        )
    write = block_writer(page, "plan") if page is not None else None
    measured, stats = read_json(rates), read_json(scenes_from)
    if "rows" not in measured:
        raise DataError(
            f"{rates} holds no rates; expected a file of `megrasp bench --stage data`."
        )
    if not stats.get("runs"):
        raise DataError(
            f"{scenes_from} says nothing of how long the scenes took; expected what `megrasp data "
            "stats` prints of a scene data set made by this version."
        )
    spent = sum(run["cpu_seconds"] for run in stats["runs"])
    made = sum(run["done"] for run in stats["runs"])
    content = plan_data(
        measured,
        spent / max(made, 1),
        objects=objects,
        grippers=grippers,
        successes=successes,
        scenes=scenes,
        cores=cores,
    )
    emit(content, out)
    table = plan_table(content)
    say(table)
    if write is not None:
        write(f"{table}\n")
    return 0

"""`megrasp gripper postures`: search for the postures of a hand that hold the most objects."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import tyro

from megrasp_core.cli.common import block_writer, emit, progress_bar, say

__all__ = ["posture_table", "postures"]


def postures(
    name: tyro.conf.Positional[str],
    out: Path,
    page: Path | None = None,
    variants: int = 81,
    rounds: int = 3,
    objects: int = 4,
    candidates: int = 6,
    held_out: int = 120,
    scale: float = 0.15,
    executor: Literal["local", "ray"] = "local",
    address: str | None = None,
    workers: int = 1,
    seed: int = 0,
) -> int:
    """Search for the open and closed postures of a hand that hold the most objects.

    Variations of the postures in its gripper.yaml compete in free-space trials on procedural
    objects; listed and found postures are then measured on objects the search has not seen. Trials
    are kept beside the result, so that a search that was stopped goes on with the same command.
    The gripper.yaml is not changed: postures that are better are printed as it takes them; copy
    them, also into the description of the CAD model where there is one. Exit code 1 where nothing
    better was found.

    Try: megrasp gripper postures allegro_hand --out postures/allegro_hand.json --workers 2

    Args:
        name: registered name, or folder of a gripper.yaml.
        out: JSON.
        page: markdown page whose lines between <!-- postures --> and <!-- /postures --> become a
            table of all results in the folder of `out`.
        variants: postures tried in the first rung of a round; one in three goes on to three times
            the objects.
        rounds: rounds, each closer around the best so far.
        objects: objects of a round's first rung.
        candidates: grasps tried per object and posture.
        held_out: unseen objects of the final measurement.
        scale: spread of the first round, as a share of each joint's range.
        executor: local processes or a Ray cluster.
        address: of the Ray cluster.
        workers: processes or tasks in flight.
        seed: of variations and grasps.
    """
    import yaml

    from megrasp_core.gripper_tools.posture_search import PostureSearch, PostureSearchSettings
    from megrasp_core.jobs import ExecutorConfig

    write = None if page is None else block_writer(page, "postures")
    settings = PostureSearchSettings(
        variants=variants, rounds=rounds, objects=objects, candidates=candidates, scale=scale,
        held_out=held_out, seed=seed,
    )  # fmt: skip
    start = time.monotonic()
    with progress_bar(None, "trials") as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.n = done
            bar.refresh()

        where = ExecutorConfig(executor, workers, address)
        memory = out.with_suffix(".trials.jsonl")
        result = PostureSearch(name, settings, memory, where, tell).run()
    emit(result, out)
    if write is not None:
        write(posture_table(sorted(out.parent.glob("*.json"))))
    for entry in ("listed", "found"):
        say(f"{entry:<7s} {_line(result[entry]['held_out'])}")
    say(f"{result['trials']} grasps; this run took {time.monotonic() - start:.0f} s")
    rates = [result[entry]["held_out"]["grasps"]["successes"] for entry in ("listed", "found")]
    if rates[1] <= rates[0]:
        say("nothing better was found")
        return 1
    block = {"postures": result["found"]["postures"]}
    say(yaml.safe_dump(block, sort_keys=False, default_flow_style=None, width=99))
    return 0


def posture_table(results: Sequence[Path]) -> str:
    """Markdown table of what listed and found postures held of the unseen objects."""
    lines = [
        "| hand | grasps held, listed | found | objects held, listed | found | start collisions, "
        "listed | found |",
        "|---|---|---|---|---|---|---|",
    ]
    for file in results:
        result = json.loads(file.read_text())
        both = [result[entry]["held_out"] for entry in ("listed", "found")]
        cells = [_share(entry[what]) for what in ("grasps", "objects") for entry in both]
        cells += [str(entry["start_collisions"]) for entry in both]
        lines.append(f"| {' | '.join([result['gripper'], *cells])} |")
    return "\n".join(lines) + "\n"


def _share(entry: dict[str, Any]) -> str:
    low, high = entry["ci95"] or (0.0, 1.0)
    share = f"{100 * entry['rate']:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
    return f"{share} ({entry['successes']}/{entry['trials']})"


def _line(measured: dict[str, Any]) -> str:
    parts = []
    for what in ("grasps", "objects"):
        entry = measured[what]
        low, high = entry["ci95"] or (0.0, 1.0)
        parts.append(
            f"{entry['successes']} of {entry['trials']} {what} held (95 % {100 * low:.1f} to "
            f"{100 * high:.1f} %)"
        )
    return ", ".join([*parts, f"{measured['start_collisions']} start collisions"])

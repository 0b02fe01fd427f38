"""`megrasp gripper fidelity`: own descriptions against the CAD models of the same grippers."""

from __future__ import annotations

import json
from pathlib import Path

import tyro

from megrasp_core.cli.common import Names, block_writer, emit, progress_bar, say

__all__ = ["fidelity"]


def fidelity(
    names: tyro.conf.Positional[Names] = (),
    out: Path = Path("gripper_fidelity.json"),
    page: Path | None = None,
) -> int:
    """Hold own descriptions against the CAD models of the same grippers.

    Every description <name> that has a twin cad/<name>_cad is compared with it; the models lie
    under MEGRASP_ASSETS. Exit code 1 where a measure is over its limit.

    Try: megrasp gripper fidelity --out docs/results/gripper_fidelity.json --page docs/grippers.md

    Args:
        names: only these; what the file holds of others is kept.
        out: JSON.
        page: markdown page whose lines between <!-- fidelity --> and <!-- /fidelity --> become
            the table.
    """
    from megrasp_core.gripper_tools.fidelity import fidelity_of_twins, markdown_table
    from megrasp_core.grippers import cad_twins

    kept = {}
    if names and out.is_file():
        kept = {entry["gripper"]: entry for entry in json.loads(out.read_text())}
    write = None if page is None else block_writer(page, "fidelity")
    count = len(names) or len(cad_twins())
    with progress_bar(count, "compare") as bar:
        for result in fidelity_of_twins(names):
            kept[result.gripper] = result.to_dict()
            bar.update()
    results = [kept[name] for name in sorted(kept)]
    table = markdown_table(results)
    emit(results, out)
    say(table)
    if write is not None:
        write(table)
        say(f"wrote {page}")
    return 0 if all(result["passed"] for result in results) else 1

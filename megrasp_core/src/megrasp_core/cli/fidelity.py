"""`megrasp gripper fidelity`: own descriptions against the CAD models of the same grippers."""

from __future__ import annotations

import json
from pathlib import Path

import tyro

from ..errors import InvalidRequestError
from .common import Names, emit, progress_bar, say

__all__ = ["fidelity"]

MARKS = ("<!-- fidelity -->", "<!-- /fidelity -->")
"""Lines of a markdown page between which the fidelity table stands."""


def fidelity(
    names: tyro.conf.Positional[Names] = (),
    out: Path = Path("gripper_fidelity.json"),
    page: Path | None = None,
) -> int:
    """Hold own descriptions against the CAD models of the same grippers.

    Every description <name> that has a twin cad/<name>_cad is compared with it; the models lie
    under MEGRASP_ASSETS. Exit code 1 where a measure is over its limit.

    Try: megrasp gripper fidelity --out docs/gripper_fidelity.json --page docs/grippers.md

    Args:
        names: only these; what the file holds of others is kept.
        out: JSON.
        page: markdown page whose lines between <!-- fidelity --> and <!-- /fidelity --> become
            the table.
    """
    from ..grippers import cad_twins
    from ..grippers.fidelity import fidelity_of_twins, markdown_table

    kept = {}
    if names and out.is_file():
        kept = {entry["gripper"]: entry for entry in json.loads(out.read_text())}
    parts = None if page is None else _around(page)
    count = len(names) or len(cad_twins())
    with progress_bar(count, "compare") as bar:
        for result in fidelity_of_twins(names):
            kept[result.gripper] = result.to_dict()
            bar.update()
    results = [kept[name] for name in sorted(kept)]
    table = markdown_table(results)
    emit(results, out)
    say(table)
    if page is not None and parts is not None:
        page.write_text(f"{parts[0]}{MARKS[0]}\n{table}{MARKS[1]}{parts[1]}")
        say(f"wrote {page}")
    return 0 if all(result["passed"] for result in results) else 1


def _around(page: Path) -> tuple[str, str]:
    """Text before and after the marked lines of a page."""
    text = page.read_text() if page.is_file() else ""
    before, found, rest = text.partition(MARKS[0])
    _, ended, after = rest.partition(MARKS[1])
    if not (found and ended):
        raise InvalidRequestError(
            f"page {page} has no lines {MARKS[0]} and {MARKS[1]}; expected a page that has both, "
            "add them where the table shall stand."
        )
    return before, after

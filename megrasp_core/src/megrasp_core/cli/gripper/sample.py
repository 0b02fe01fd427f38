"""`megrasp gripper sample`: grippers of the procedural family."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from megrasp_core.cli.common import Flag, emit, progress_bar, say
from megrasp_core.errors import InvalidRequestError

__all__ = ["sample"]

SHEET_COUNT = 24


def sample(
    out: Path,
    count: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 24,
    seed: int = 0,
    kind: str | None = None,
    check: Flag = False,
    report: Path | None = None,
    sheet: Path | None = None,
) -> int:
    """Write grippers drawn at random: the family that networks train on.

    Each gets a folder <name>/ with gripper.yaml and model.xml. Folders that are whole are kept, so
    that a run that was stopped goes on with the same command. The check loads and closes each
    gripper, compares its open and closed clouds and has it hold a suitable box or cylinder in the
    free-space trial; exit code 1 where one does not load or close.

    Try: megrasp gripper sample -n 1000 --seed 1 --out my_grippers --sheet my_grippers.png

    Args:
        out: folder that the gripper folders go into.
        count: how many.
        seed: of the first; the others follow.
        kind: draw this kind only: parallel_slide, parallel_linkage, angular, centric,
            two_against_one or four_finger.
        check: put every gripper to the test.
        report: JSON with the outcome of the check.
        sheet: PNG of the first 24.
    """
    from megrasp_core.grippers import is_whole, sample_gripper, write_gripper

    if count < 1:
        raise InvalidRequestError(f"asked for {count} grippers; expected at least 1.")
    if report is not None and not check:
        raise InvalidRequestError("--report was given without --check; expected both.")
    folders, kept = [], 0
    with progress_bar(count, "grippers") as bar:
        for number in range(seed, seed + count):
            description, model = sample_gripper(number, kind)
            if is_whole(out, description, model):
                folders.append(out / description["name"])
                kept += 1
            else:
                folders.append(write_gripper(out, description, model))
            bar.update()
    say(f"wrote {count - kept} grippers to {out}" + (f", kept {kept}" if kept else ""))
    if sheet is not None:
        _draw(folders[:SHEET_COUNT], sheet)
    return _check(folders, report) if check else 0


def _draw(folders: list[Path], sheet: Path) -> None:
    from megrasp_core.gripper_tools.family_check import family_sheet

    with progress_bar(len(folders), "pictures") as bar:
        family_sheet(folders, sheet, bar.update)
    say(f"wrote {sheet}")


def _check(folders: list[Path], report: Path | None) -> int:
    from megrasp_core.gripper_tools.family_check import check_family_gripper, summary, text

    results = []
    with progress_bar(len(folders), "check") as bar:
        for folder in folders:
            results.append(check_family_gripper(folder))
            bar.update()
    content = summary(results)
    if report is not None:
        emit(content, report)
    say(text(content))
    for failure in content["failures"]:
        if failure["error"] is not None:
            say(f"{failure['name']}: {failure['error']}")
    return 0 if content["sound"]["successes"] == len(results) else 1

"""`megrasp data verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from megrasp_core.cli.common import Flag, progress_bar, say
from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.storage.integrity import Damage

__all__ = ["verify"]


def verify(out: Annotated[Path, tyro.conf.arg(aliases=["--data"])], repair: Flag = False) -> int:
    """Read every byte of a data set or library and name what is damaged; exit code 1 if any is.

    Try: megrasp data verify --out data/scenes
         megrasp data verify --out data/library --repair

    Args:
        out: folder of `data scenes` or `data grasps`, or a packed library or device pack.
        repair: move damaged files to the folder `damaged` within and keep what is whole in them;
            the command that made the data then makes the rest anew. Nothing is deleted.
    """
    from megrasp_core.storage import verify_pack
    from megrasp_core.storage.device_pack import SUFFIX

    if out.suffix == SUFFIX:
        if repair:
            raise InvalidRequestError(
                f"--repair was given and {out} is a device pack; expected a folder. Make the pack "
                "again with `megrasp data pack --device`."
            )
        lines = verify_pack(out)
        damaged = len(lines)
    else:
        found = _findings(out)
        lines = [str(finding) for finding in found]
        damaged = sum(finding.damaged for finding in found)
        if repair:
            return _repair(out, found)
    for line in lines:
        say(line)
    say(f"{damaged} damaged, {len(lines) - damaged} notes; {out}")
    if damaged and out.suffix != SUFFIX:
        say("with --repair they are moved aside, then run the command that made them again")
    return 1 if damaged else 0


def _is_scenes(out: Path) -> bool:
    return any((out / name).exists() for name in ("manifest.json", "scenes", "shards"))


def _findings(out: Path) -> list[Damage]:
    from megrasp_core.library import verify_library
    from megrasp_core.storage import verify_dataset

    check = verify_dataset if _is_scenes(out) else verify_library
    with progress_bar(None, "files") as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return check(out, tell)


def _repair(out: Path, found: list[Damage]) -> int:
    from megrasp_core.storage import move_aside
    from megrasp_core.storage.scene_writer import lock

    release = lock(out) if _is_scenes(out) else None
    folder = out if out.is_dir() else out.parent
    for finding in found:
        say(str(finding))
        if finding.damaged:
            say(f"  moved to {move_aside(finding, folder) or 'nowhere, there is no file'}")
    if release is not None:
        release()
    say(f"{sum(finding.damaged for finding in found)} moved aside; {out}")
    say("run the command that made them again: it makes what is missing")
    return 0

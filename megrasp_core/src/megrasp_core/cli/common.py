"""What several commands share: output, progress, region files, argument types."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ..errors import InvalidRequestError

if TYPE_CHECKING:
    from tqdm import tqdm

    from ..pointcloud import OrientedBox

__all__ = ["Flag", "Names", "block_writer", "emit", "progress_bar", "read_region", "say"]

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""A switch without a --no- twin."""

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")]


def say(line: str) -> None:
    """One line for the user, to standard output."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def emit(content: Any, out: Path | None) -> None:
    """Write JSON to a file, or to standard output without one."""
    text = json.dumps(content, indent=1) + "\n"
    if out is None:
        sys.stdout.write(text)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text)
    say(f"wrote {out}")


def block_writer(page: Path, mark: str) -> Callable[[str], object]:
    """Return what replaces the text between the lines <!-- mark --> and <!-- /mark --> of a
    markdown page.

    Raises:
        InvalidRequestError: the page does not have both; told now, before any work is done.
    """
    start, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    text = page.read_text() if page.is_file() else ""
    before, found, rest = text.partition(start)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise InvalidRequestError(
            f"page {page} has no lines {start} and {end}; expected a page that has both, "
            "add them where the text shall stand."
        )
    return lambda block: page.write_text(f"{before}{start}\n{block}{end}{after}")


def progress_bar(total: int | None, what: str) -> tqdm:
    """A bar on standard error; silent where that is no terminal."""
    from tqdm import tqdm

    return tqdm(total=total, desc=what, file=sys.stderr, disable=None, leave=False)


def read_region(path: Path) -> tuple[OrientedBox, bool]:
    """Region and whether it is a bin, from a JSON or YAML file.

    `pose: [x, y, z, qx, qy, qz, qw]` of the centre, `size: [x, y, z]` full edges (m), and
    optionally `walls: false` for a box that is no bin.

    Raises:
        InvalidRequestError: the file is missing or wrong.
    """
    import yaml

    from ..lie.pose import matrix_from_pose7
    from ..pointcloud import OrientedBox

    expected = (
        "expected JSON or YAML with pose: [x, y, z, qx, qy, qz, qw] and size: [x, y, z] (m), and "
        "optionally walls: true or false"
    )
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InvalidRequestError(
            f"region file {path} cannot be read ({error}); {expected}."
        ) from None
    if not isinstance(content, dict) or set(content) - {"pose", "size", "walls"}:
        raise InvalidRequestError(f"region file {path} holds {content!r}; {expected}.")
    try:
        pose = [float(v) for v in content["pose"]]
        size = [float(v) for v in content["size"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"region file {path} is incomplete ({error!r}); {expected}."
        ) from None
    if len(pose) != 7 or len(size) != 3:
        raise InvalidRequestError(
            f"region file {path} has a pose of {len(pose)} and a size of {len(size)} numbers; "
            f"{expected}."
        )
    return OrientedBox(matrix_from_pose7(pose), size), bool(content.get("walls", True))  # type: ignore[arg-type]

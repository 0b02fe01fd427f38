"""What several commands share: output, progress, region files, argument types."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro

from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from tqdm import tqdm

    from megrasp_core.pointcloud import OrientedBox

__all__ = [
    "Flag",
    "Names",
    "block_writer",
    "changed",
    "emit",
    "progress_bar",
    "read_region",
    "say",
]

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
    optionally `walls: false` for a box that is no bin. What `megrasp bin find` writes has `found`
    besides, which says nothing of the region.

    Raises:
        InvalidRequestError: the file is missing or wrong.
    """
    import numpy as np
    import yaml

    from megrasp_core.lie import matrix_from_pose7
    from megrasp_core.pointcloud import OrientedBox

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
    if not isinstance(content, dict) or set(content) - {"pose", "size", "walls", "found"}:
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
    walls = content.get("walls", True)
    if not isinstance(walls, bool):
        raise InvalidRequestError(f"region file {path} has walls: {walls!r}; {expected}.")
    box = OrientedBox(matrix_from_pose7(pose), np.array(size))
    box.check_units()
    return box, walls


Dataclass = TypeVar("Dataclass")


def changed(settings: Dataclass, changes: Sequence[str], option: str) -> Dataclass:
    """A dataclass with fields set from `NAME=VALUE` texts; `outer.inner=VALUE` sets a field of a
    field. Lists are written as `[1, 2]`.

    Raises:
        InvalidRequestError: no such field, or a value of another type.
    """
    import yaml

    for change in changes:
        name, equals, text = change.partition("=")
        if not equals:
            raise InvalidRequestError(f"{option} {change} was given; expected NAME=VALUE.")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError:
            value = text
        settings = _with(settings, name.split("."), value, f"{option} {change}")
    return settings


def _with(settings: Any, path: list[str], value: Any, given: str) -> Any:
    names = [field.name for field in dataclasses.fields(settings)]
    if path[0] not in names:
        raise InvalidRequestError(
            f"{given} names no field of {type(settings).__name__}; expected one of "
            f"{', '.join(names)}."
        )
    before = getattr(settings, path[0])
    if len(path) > 1:
        if not dataclasses.is_dataclass(before):
            raise InvalidRequestError(f"{given}: {path[0]} has no fields; expected its value.")
        value = _with(before, path[1:], value, given)
    elif isinstance(value, list):
        value = tuple(value)
    wanted = get_type_hints(type(settings))[path[0]]
    if wanted is float or float in get_args(wanted):
        value = _number(value)
    if not _fits(value, wanted):
        raise InvalidRequestError(f"{given}: expected a value like {before!r}.")
    return dataclasses.replace(settings, **{path[0]: value})


def _number(value: Any) -> Any:
    """A float where there is one: YAML takes 1e-3 for text and 1 for a whole number."""
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        return value
    try:
        return float(value)
    except ValueError:
        return value


def _fits(value: Any, wanted: Any) -> bool:
    """Whether a value read from text is of a field's type."""
    origin = get_origin(wanted)
    if origin is Literal:
        return value in get_args(wanted)
    if origin in (Union, UnionType):
        return any(_fits(value, part) for part in get_args(wanted))
    if origin is tuple:
        parts = get_args(wanted)
        return isinstance(value, tuple) and all(_fits(v, parts[0]) for v in value)
    if wanted is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    if wanted is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, wanted) if isinstance(wanted, type) else value is None

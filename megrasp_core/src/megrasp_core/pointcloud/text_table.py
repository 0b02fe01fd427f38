"""Rows of numbers as text, as PLY and PCD files have them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError


def text_columns(
    path: Path, data: bytes, names: Sequence[str], *, skip: int, count: int, what: str
) -> dict[str, NDArray[np.float64]]:
    """Columns of `count` rows after `skip` others.

    Args:
        path: named in errors.
        data: lines of numbers; empty lines do not count.
        names: of the numbers in a row.
        skip: rows before the first.
        count: rows.
        what: a row is, for errors.

    Raises:
        CloudError: there are fewer rows, or one does not hold that many numbers.
    """
    lines = [line for line in data.split(b"\n") if line.strip()][skip : skip + count]
    if lines and data.endswith(lines[-1]) and len(lines) == count:
        # Without an end of line nobody knows whether the last number is whole.
        lines, count = lines[:-1], count - 1
    if len(lines) < count:
        raise CloudError(
            f"{path} ends at {what} {len(lines)} of {count}; expected a whole file. Copy or save "
            "it again."
        )
    rows = [line.split() for line in lines]
    width = len(names)
    try:
        if any(len(row) != width for row in rows) or any(b"_" in line for line in lines):
            raise ValueError
        table = np.array(rows, dtype=np.float64).reshape(count, width)
    except ValueError:
        wrong = next(i for i, row in enumerate(rows) if len(row) != width or not _numbers(row))
        raise CloudError(
            f"{path} is damaged at {what} {wrong} of {count}: "
            f"{lines[wrong][:60].decode('latin-1')!r}; expected {width} numbers. Copy or save it "
            "again."
        ) from None
    return {name: table[:, place] for place, name in enumerate(names)}


def _numbers(row: Sequence[bytes]) -> bool:
    """Whether all are numbers; Python takes 1_0 for one, too."""
    try:
        return len([float(word) for word in row]) == len(row) and not any(b"_" in w for w in row)
    except ValueError:
        return False

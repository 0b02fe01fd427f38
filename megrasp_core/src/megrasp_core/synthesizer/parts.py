"""Calls of the network on many poses, a part of them at a time where memory is short."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

__all__ = ["in_parts"]


def in_parts(call: Callable[[Tensor], Tensor], count: int, at_once: int | None) -> Tensor:
    """What `call` returns for all rows, (count, ...).

    Args:
        call: takes the indices of some rows and returns one row for each.
        count: how many rows there are.
        at_once: most rows a call; None: all.
    """
    rows = torch.arange(count)
    if at_once is None or count <= at_once:
        return call(rows)
    return torch.cat([call(part) for part in rows.split(at_once)])

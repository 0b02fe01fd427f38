"""Keeping poses out of autocast: bfloat16 would round a metre to 4 mm."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast

import torch

Function = TypeVar("Function", bound=Callable[..., Any])


class _OnDevice(Protocol):
    @property
    def device(self) -> torch.device: ...


def full_precision(function: Function) -> Function:
    """Run a function with autocast switched off; its first argument says on which device, as a
    tensor or a `PoseBatch`.
    """

    @functools.wraps(function)
    def wrapper(first: _OnDevice, *args: Any, **kwargs: Any) -> Any:
        with torch.autocast(first.device.type, enabled=False):
            return function(first, *args, **kwargs)

    return cast(Function, wrapper)

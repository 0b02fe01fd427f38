"""Memory that Python has freed, given back to the system.

glibc keeps freed memory in an arena per thread, and loading all grippers in threads that come and
go would hold half a gigabyte in each. Where there is no glibc nothing is done.
"""

from __future__ import annotations

import ctypes
import gc

_M_ARENA_MAX = -8
"""Of malloc.h."""


def few_arenas(number: int = 2) -> None:
    """Let all threads share so many arenas; those that exist stay."""
    mallopt = _function("mallopt")
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, number)


def give_back() -> None:
    """Collect garbage and give the system what is free."""
    gc.collect()
    trim = _function("malloc_trim")
    if trim is not None:
        trim(0)


def _function(name: str) -> ctypes._NamedFuncPointer | None:
    return getattr(ctypes.CDLL(None), name, None)

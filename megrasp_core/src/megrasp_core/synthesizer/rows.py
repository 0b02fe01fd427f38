"""Dataclasses of arrays, such as `Assessment`, row by row."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

__all__ = ["joined", "with_rows"]

T = TypeVar("T")


def joined(parts: Sequence[T]) -> T:
    """The rows of all parts, one part after another."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(parts[0]):  # type: ignore[arg-type]
        value = [getattr(part, item.name) for part in parts]
        if isinstance(value[0], np.ndarray):
            values[item.name] = np.concatenate(value)
        else:
            values[item.name] = joined(value) if dataclasses.is_dataclass(value[0]) else value[0]
    return type(parts[0])(**values)


def with_rows(target: T, index: np.ndarray, source: T, rows: np.ndarray) -> T:
    """A copy of a dataclass of arrays in which the rows `index` are the `rows` of another."""
    values: dict[str, Any] = {}
    for item in dataclasses.fields(target):  # type: ignore[arg-type]
        value, other = getattr(target, item.name), getattr(source, item.name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value[index] = other[rows]
        elif dataclasses.is_dataclass(value):
            value = with_rows(value, index, other, rows)
        values[item.name] = value
    return type(target)(**values)

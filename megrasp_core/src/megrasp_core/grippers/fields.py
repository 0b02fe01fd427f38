"""Strict reading of YAML mappings: every mistake is named together with what would be right."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from megrasp_core.errors import DescriptionError

QUATERNION_TOLERANCE = 1e-3


class Fields:
    """One mapping of a description file, read field by field.

    Args:
        data: the mapping as YAML gave it.
        where: prefix of every message, such as ``/x/gripper.yaml``.
        path: dotted path of this mapping inside the file, empty at the top.
    """

    def __init__(self, data: Any, where: str, path: str = "") -> None:
        self.where = where
        self.path = path
        if not isinstance(data, Mapping):
            raise self.error(None, f"must be a mapping of fields, got {_kind(data)}")
        self.data: Mapping[Any, Any] = data

    def error(self, field: str | None, text: str) -> DescriptionError:
        """Return (not raise) the error for one field of this mapping."""
        parts = [part for part in (self.path, field) if part]
        name = f"'{'.'.join(parts)}'" if parts else "the description"
        return DescriptionError(f"{self.where}: {name} {text}")

    def check_names(self, valid: Iterable[str], required: Iterable[str]) -> None:
        """Raise DescriptionError for fields that are unknown or missing."""
        names = list(valid)
        unknown = [str(key) for key in self.data if key not in names]
        if unknown:
            raise self.error(
                None, f"has an unknown field '{unknown[0]}'; valid fields: {', '.join(names)}"
            )
        missing = [name for name in required if name not in self.data]
        if missing:
            raise self.error(
                None, f"lacks the field '{missing[0]}'; required fields: {', '.join(required)}"
            )

    def sub(self, field: str) -> Fields:
        """Return the mapping held by `field`."""
        path = f"{self.path}.{field}" if self.path else field
        return Fields(self.data[field], self.where, path)

    def text(self, field: str, valid: Iterable[str] | None = None) -> str:
        """Return a string that is not empty, one of `valid` where given."""
        value = self.data[field]
        if not isinstance(value, str) or not value.strip():
            raise self.error(field, f"must be a text that is not empty, got {_kind(value)}")
        if valid is not None and value not in (choices := list(valid)):
            raise self.error(field, f"is '{value}'; valid choices: {', '.join(choices)}")
        return value

    def integer(self, field: str, minimum: int) -> int:
        """Return a whole number of at least `minimum`."""
        value = self.data[field]
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise self.error(field, f"must be a whole number of at least {minimum}, got {value!r}")
        return value

    def number(
        self, field: str, minimum: float | None = None, above: float | None = None
    ) -> float:
        """Return a finite float, `>= minimum` and `> above` where given."""
        value = _finite(self.data[field])
        if value is None:
            raise self.error(field, f"must be a finite number, got {_kind(self.data[field])}")
        if minimum is not None and value < minimum:
            raise self.error(field, f"must be at least {minimum:g}, got {value:g}")
        if above is not None and value <= above:
            raise self.error(field, f"must be greater than {above:g}, got {value:g}")
        return value

    def numbers(self, field: str, count: int) -> tuple[float, ...]:
        """Return `count` finite floats."""
        value = self.data[field]
        items = [_finite(item) for item in value] if isinstance(value, (list, tuple)) else []
        if len(items) != count or any(item is None for item in items):
            raise self.error(field, f"must be a list of {count} finite numbers, got {value!r}")
        return tuple(item for item in items if item is not None)

    def quaternion(self, field: str) -> tuple[float, float, float, float]:
        """Return a unit quaternion (x, y, z, w); its norm may be off by 1e-3."""
        x, y, z, w = self.numbers(field, 4)
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise self.error(
                field,
                f"must be a unit quaternion [x, y, z, w], got [{x:g}, {y:g}, {z:g}, {w:g}] "
                f"of norm {norm:.4g}",
            )
        return x, y, z, w

    def named_numbers(self, field: str) -> dict[str, float]:
        """Return a mapping from names to finite floats, not empty."""
        inner = self.sub(field)
        if not inner.data:
            raise inner.error(None, "must not be empty")
        for key in inner.data:
            if not isinstance(key, str):
                raise inner.error(None, f"must have names as keys, got {key!r}")
        return {key: inner.number(key) for key in inner.data}


def _finite(value: Any) -> float | None:
    """Return `value` as a finite float, or None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def _kind(value: Any) -> str:
    """Describe a wrong value for a message."""
    if value is None:
        return "nothing (null)"
    return f"{value!r} ({type(value).__name__})"

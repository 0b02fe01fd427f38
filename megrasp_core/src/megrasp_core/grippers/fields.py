"""Strict reading of YAML mappings: every mistake is named together with what would be right."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from megrasp_core.errors import DescriptionError

QUATERNION_TOLERANCE = 1e-3
LARGEST = 3.0
"""No length of a gripper is greater (m); a millimetre model's are."""

SHOWN = 120
"""Characters of a wrong value that a message shows."""


def choices(kind: str, given: str, valid: Iterable[str]) -> str:
    """Return "valid <kind>: a, b", and the name like `given` where there is one."""
    names = [name for name in valid if name]
    near = get_close_matches(given, names, n=1)
    meant = f"; did you mean '{near[0]}'?" if near else ""
    return f"valid {kind}: {', '.join(names) or '(none)'}{meant}"


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
            raise self.error(None, f"must be a mapping of fields (name: value), got {_kind(data)}")
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
                None,
                f"has an unknown field '{unknown[0]}'; {choices('fields', unknown[0], names)}",
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
        if valid is not None and value not in (names := list(valid)):
            raise self.error(field, f"is '{value}'; {choices('choices', value, names)}")
        return value

    def integer(self, field: str, minimum: int) -> int:
        """Return a whole number of at least `minimum`."""
        value = self.data[field]
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise self.error(
                field, f"must be a whole number of at least {minimum}, got {_kind(value)}"
            )
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

    def length(
        self, field: str, minimum: float | None = None, above: float | None = None
    ) -> float:
        """Return a number of metres, at most those of a gripper."""
        value = self.number(field, minimum, above)
        self._check_metres(field, value)
        return value

    def point(self, field: str) -> tuple[float, float, float]:
        """Return three coordinates in metres, at most those of a gripper."""
        x, y, z = self.numbers(field, 3)
        self._check_metres(field, x, y, z)
        return x, y, z

    def _check_metres(self, field: str, *values: float) -> None:
        worst = max(abs(value) for value in values)
        if worst > LARGEST:
            raise self.error(
                field,
                f"holds {worst:g}; expected metres, at most {LARGEST:g} ({worst:g} mm are "
                f"{worst / 1000:g})",
            )

    def numbers(self, field: str, count: int) -> tuple[float, ...]:
        """Return `count` finite floats."""
        value = self.data[field]
        items = [_finite(item) for item in value] if isinstance(value, (list, tuple)) else []
        if len(items) != count or any(item is None for item in items):
            hints = map(_hint, value) if isinstance(value, (list, tuple)) else ()
            raise self.error(
                field,
                f"must be a list of {count} finite numbers, got {show(value)}"
                f"{next(filter(None, hints), '')}",
            )
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

    def names(self) -> list[str]:
        """Return the keys, all of them texts."""
        for key in self.data:
            if not isinstance(key, str):
                raise self.error(None, f"must have names as keys, got {_kind(key)}")
        return list(self.data)

    def named_numbers(self, field: str) -> dict[str, float]:
        """Return a mapping from names to finite floats, not empty."""
        inner = self.sub(field)
        if not inner.data:
            raise inner.error(None, "must not be empty; expected name: value")
        return {key: inner.number(key) for key in inner.names()}


def show(value: Any) -> str:
    """Return a value as a message shows it, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits.
        text = "a number of thousands of digits"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def _finite(value: Any) -> float | None:
    """Return `value` as a finite float, or None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _kind(value: Any) -> str:
    """Describe a wrong value for a message."""
    if value is None:
        return "nothing (null)"
    return f"{show(value)} ({type(value).__name__}){_hint(value)}"


def _hint(value: Any) -> str:
    """Return what to write for a number that YAML takes for a text, such as 1e-3."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        return ""
    return f", which YAML takes for a text; write {number!r}" if math.isfinite(number) else ""

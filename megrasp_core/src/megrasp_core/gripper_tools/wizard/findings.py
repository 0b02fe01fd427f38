"""What the wizard found, how sure it is, and what it did on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

MOST_SHOWN = 6
LONGEST = 70

SURE, LIKELY, GUESS = "sure", "likely", "guess"


@dataclass(frozen=True)
class Finding:
    """One answer: `what` it is, its `value`, `sureness` ("sure", "likely", "guess"), `why`, and
    the `option` that overrides it.
    """

    what: str
    value: Any
    sureness: str
    why: str
    option: str

    def line(self) -> str:
        """Return one line for a person."""
        return f"{self.what:<10s} {show(self.value):<44s} {self.sureness:<7s} {self.why}"


@dataclass
class Notes:
    """Lines about what was done to the model."""

    lines: list[str] = field(default_factory=list)

    def add(self, line: str) -> None:
        """Add a line once."""
        if line not in self.lines:
            self.lines.append(line)


def show(value: Any) -> str:
    """Return a value as short text."""
    if isinstance(value, dict) and len(value) > MOST_SHOWN:
        return f"{len(value)} values, see the file"
    if isinstance(value, dict):
        return " ".join(f"{key}={number:.4g}" for key, number in value.items())
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], (list, tuple)):
        return " | ".join(", ".join(map(str, group)) for group in value)
    if isinstance(value, (list, tuple)):
        return " ".join(f"{number:.4g}" for number in value)
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."

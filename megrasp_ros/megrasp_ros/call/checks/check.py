"""One line of `doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Check:
    """One line: what was looked at, whether it is in order, what was found and what to change."""

    what: str
    level: Level
    text: str

    def line(self) -> str:
        """For a terminal."""
        return f"{self.level:<5}{self.what:<15}{self.text}"

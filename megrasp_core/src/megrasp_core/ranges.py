"""Ranges of numbers that callers give, and one way to refuse what lies outside."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace

import numpy as np

from .errors import InvalidRequestError, MegraspError

__all__ = [
    "ANY", "COUNT", "FROM_ONE", "LENGTH", "POSITIVE", "SHARE", "WEIGHT", "Range", "check_ranges",
]  # fmt: skip


@dataclass(frozen=True)
class Range:
    """What a number may be; never NaN, infinite, a truth value or a text.

    Attributes:
        low: least value.
        high: largest value.
        above: it must be more than this.
        below: it must be less than this.
        whole: an integer.
        optional: None is taken as well.
        several: a tuple or list of such numbers.
        unit: for the message.
        advice: what to do instead, for the message.
    """

    low: float = -sys.float_info.max
    high: float = sys.float_info.max
    above: float = -math.inf
    below: float = math.inf
    whole: bool = False
    optional: bool = False
    several: bool = False
    unit: str = ""
    advice: str = ""

    def takes(self, value: object) -> bool:
        """Whether a value lies in it."""
        if value is None:
            return self.optional
        if self.several:
            one = replace(self, several=False, optional=False)
            return isinstance(value, (tuple, list)) and all(map(one.takes, value))
        kinds = (int, np.integer) if self.whole else (int, float, np.integer, np.floating)
        if isinstance(value, bool) or not isinstance(value, kinds):
            return False
        # Holds for no NaN and no infinity, and for no whole number that is too large for a float.
        return bool(self.low <= value <= self.high and self.above < value < self.below)

    def __str__(self) -> str:
        """In words, for a message."""
        words = ["a whole number" if self.whole else "a number"]
        if self.several:
            words = ["whole numbers" if self.whole else "numbers"]
        least = abs(self.low) < sys.float_info.max
        for bound, limit in (
            ("from", self.low), ("over", self.above), ("to" if least else "up to", self.high),
            ("below", self.below),
        ):  # fmt: skip
            if abs(limit) < sys.float_info.max:
                words.append(f"{bound} {limit:.12g}")
        text = " ".join(words) + (f" {self.unit}" if self.unit else "")
        return f"{text}, or none" if self.optional else text


ANY = Range()
COUNT = Range(0, whole=True)
FROM_ONE = Range(1, whole=True)
SHARE = Range(0, 1)
LENGTH = WEIGHT = Range(0)
POSITIVE = Range(above=0)


def check_ranges(
    settings: object, error: type[MegraspError] = InvalidRequestError, /, **allowed: Range
) -> None:
    """Refuse settings of which some are outside their ranges, all in one message.

    Args:
        settings: a dataclass.
        error: class of what is raised.
        allowed: ranges by the name of the field.

    Raises:
        MegraspError: of the class `error`.
    """
    wrong = []
    for name, wanted in allowed.items():
        value = getattr(settings, name)
        if not wanted.takes(value):
            told = f"{name} {value!r} was given; expected {wanted}."
            wrong.append(f"{told} {wanted.advice}".rstrip())
    if wrong:
        raise error(" ".join(wrong))

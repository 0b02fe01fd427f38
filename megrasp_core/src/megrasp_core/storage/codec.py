"""How poses and texts become small integers in every file, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .records import GripperLabels

QUATERNION = 32767.0
"""A component of a unit quaternion is so many steps of an int16: half a step is 0.002 degrees."""
FARTHEST = 32767
"""Most steps of an int16 that a position may lie from its origin."""
T = TypeVar("T", bound=np.generic)


def pack_quaternions(quaternion: NDArray[np.floating]) -> NDArray[np.int16]:
    """Unit quaternions (n, 4) as int16."""
    return np.rint(np.clip(quaternion, -1.0, 1.0) * QUATERNION).astype(np.int16)


def unpack_quaternions(packed: NDArray[np.int16]) -> NDArray[np.float64]:
    """Unit quaternions (n, 4) of `pack_quaternions`."""
    quaternion = packed.astype(np.float64) / QUATERNION
    return quaternion / np.maximum(np.linalg.norm(quaternion, axis=1, keepdims=True), 1e-9)


def pack_positions(position: NDArray[np.floating], step: float) -> NDArray[np.int16]:
    """Positions (n, 3) (m) in steps (m) of an int16.

    Raises:
        ValueError: one lies too far from the origin.
    """
    steps = np.rint(position / step)
    if len(steps) and np.abs(steps).max() > FARTHEST:
        raise ValueError(f"a position lies more than {FARTHEST * step:.3f} m from the origin")
    return steps.astype(np.int16)


def unpack_poses(
    position: NDArray[np.int16],
    quaternion: NDArray[np.int16],
    step: float,
    origin: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """Poses (n, 7) of packed positions and quaternions."""
    place = np.asarray(origin, np.float64) + step * position.astype(np.float64)
    return np.hstack([place, unpack_quaternions(quaternion)])


class TextCodes:
    """Numbers for texts, in the order given, then in that of their first use."""

    def __init__(self, texts: Iterable[str] = ()) -> None:
        self.names: list[str] = []
        self._code: dict[str, int] = {}
        for text in texts:
            self.code(text)

    @classmethod
    def sorted(cls, texts: Iterable[str]) -> TextCodes:
        """Codes of all texts that there are, in alphabetical order."""
        return cls(sorted({str(text) for text in texts}))

    def code(self, text: str) -> int:
        """The number of a text."""
        if text not in self._code:
            self._code[text] = len(self.names)
            self.names.append(text)
        return self._code[text]

    def codes(self, texts: Iterable[str]) -> NDArray[np.int64]:
        """The numbers of texts."""
        return np.array([self.code(str(text)) for text in texts], np.int64)


def texts_of(names: list[str], codes: NDArray[np.integer]) -> NDArray[np.str_]:
    """The texts of codes.

    Raises:
        IndexError: a code has no name.
    """
    return np.array([*names, ""], np.str_)[codes]


def split(joined: GripperLabels, counts: Mapping[str, int]) -> dict[str, GripperLabels]:
    """Labels of several grippers, one after another, as they were before they were joined."""
    labels, start = {}, 0
    for name, count in counts.items():
        labels[name] = joined.part(slice(start, start + count))
        start += count
    return labels

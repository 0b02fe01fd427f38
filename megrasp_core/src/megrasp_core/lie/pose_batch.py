"""Many poses as tensors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True, eq=False)
class PoseBatch:
    """Poses (R, t) = a_from_b.

    Attributes:
        rotation: (..., 3, 3).
        translation: (..., 3) m.
    """

    rotation: Tensor
    translation: Tensor

    def __len__(self) -> int:
        """Size of the first dimension."""
        return len(self.translation)

    @property
    def device(self) -> torch.device:
        """Where the poses are."""
        return self.translation.device

    def part(self, index: Tensor | Sequence[int]) -> PoseBatch:
        """The poses of an index along the first dimension."""
        return PoseBatch(self.rotation[index], self.translation[index])

    def to(self, device: torch.device | str) -> PoseBatch:
        """The same on another device."""
        return PoseBatch(self.rotation.to(device), self.translation.to(device))

    @staticmethod
    def joined(parts: Sequence[PoseBatch]) -> PoseBatch:
        """All poses, one part after another."""
        return PoseBatch(
            torch.cat([part.rotation for part in parts]),
            torch.cat([part.translation for part in parts]),
        )

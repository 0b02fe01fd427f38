"""The grippers of a run: their tokens for the network, made when first asked for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from megrasp_core.grippers import Gripper, GripperTokens, is_procedural, load_gripper

TOKEN_SEEDS, PROCEDURAL_SEEDS = 8, 2
"""Samplings of a gripper's surface that training draws from; there are many procedural ones."""


class GripperRack:
    """Grippers by name.

    Args:
        tokens: per posture.
    """

    def __init__(self, tokens: int) -> None:
        self._count = tokens
        self._load = lru_cache(maxsize=None)(load_gripper)

    def gripper(self, name: str) -> Gripper:
        """A gripper by its name.

        Raises:
            UnknownGripperError: no such gripper.
        """
        return self._load(name)

    def fold(self, name: str) -> int:
        """Of its symmetry about the TCP's +Z."""
        return max(1, int(self.gripper(name).description.symmetry))

    def is_hand(self, name: str) -> bool:
        """Whether it is of kind `hand`."""
        return self.gripper(name).description.kind == "hand"

    def tokens(self, name: str, rng: np.random.Generator | None = None) -> GripperTokens:
        """A random sampling of its surface, or the one of inference."""
        seeds = PROCEDURAL_SEEDS if is_procedural(name) else TOKEN_SEEDS
        seed = 0 if rng is None else int(rng.integers(seeds))
        return self.gripper(name).tokens(self._count, seed=seed)

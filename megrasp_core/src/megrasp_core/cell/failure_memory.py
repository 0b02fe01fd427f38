"""Where grasps failed: a robot does not go back there while there is anything else to pick."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["FailureMemory"]

Answer = TypeVar("Answer")

CHANGED = 0.08
"""So near (m) to a grasp that lifted something the scene has changed, and what failed there may
hold now."""


class FailureMemory:
    """Grasps that failed, of use as `exclude` of the next synthesis.

    What failed since the last success is always excluded. What failed before is excluded until
    something beside it is lifted, or until no other grasp is found: an object that slipped, or an
    obstacle that looks like an object, would else be tried again after every success.

    Attributes:
        in_a_row: attempts without success since the last one, those with nothing to execute
            counted.
    """

    def __init__(self) -> None:
        self.in_a_row = 0
        self._recent: list[NDArray[np.float64]] = []
        self._earlier: list[NDArray[np.float64]] = []

    @property
    def recent(self) -> list[NDArray[np.float64]]:
        """world_from_tcp (4, 4) of what failed since the last success."""
        return list(self._recent)

    @property
    def excluded(self) -> list[NDArray[np.float64]]:
        """world_from_tcp (4, 4) of what is not to be tried again."""
        return [*self._earlier, *self._recent]

    def count(self, success: bool, world_from_tcp: NDArray[np.float64] | None) -> None:
        """Take in one attempt; `world_from_tcp` (4, 4): what was executed, None for nothing."""
        pose = None if world_from_tcp is None else np.array(world_from_tcp, dtype=float)
        if not success:
            self.in_a_row += 1
            if pose is not None:
                self._recent.append(pose)
            return
        failed = self.excluded
        if pose is not None:
            failed = [p for p in failed if np.linalg.norm(p[:3, 3] - pose[:3, 3]) > CHANGED]
        self._earlier, self._recent, self.in_a_row = failed, [], 0

    def release(self) -> bool:
        """Allow what failed before the last success; whether there was any."""
        released = bool(self._earlier)
        self._earlier = []
        return released

    def give_up(self) -> None:
        """Begin to count anew, as for another object; what failed stays excluded."""
        self._earlier, self._recent, self.in_a_row = self.excluded, [], 0

    def clear(self) -> None:
        """Forget everything, as for another gripper."""
        self._recent, self._earlier, self.in_a_row = [], [], 0

    def ask(
        self,
        synthesize: Callable[[list[NDArray[np.float64]]], Answer],
        has_grasps: Callable[[Answer], bool],
    ) -> Answer:
        """What `synthesize` answers with the failures as `exclude`; without grasps in it, what it
        answers when those before the last success are allowed again.
        """
        answer = synthesize(self.excluded)
        if not has_grasps(answer) and self.release():
            answer = synthesize(self.excluded)
        return answer

"""Which procedural objects are for what: ranges of seeds that share none, so that nothing is
judged, or chosen, on what it was made with.
"""

from __future__ import annotations

from enum import Enum

__all__ = ["ObjectSeeds"]


class ObjectSeeds(Enum):
    """First seed and end of the procedural objects of each use."""

    TRAINING = range(0, 700_000)
    CALIBRATION = range(700_000, 800_000)
    """On which the score is fitted."""
    BIN_FINDER = range(800_000, 900_000)
    """Of the bench of bins that are found."""
    VALIDATION = range(900_000, 1_000_000)
    """On which checkpoints and thresholds are chosen."""
    EVALUATION = range(1_000_000, 1_100_000)
    """Of success rates without object folders."""
    POSTURE_SEARCH = range(1_100_000, 1_200_000)
    POSTURE_MEASUREMENT = range(1_200_000, 1_300_000)
    """Of the final measurement of a search for postures."""
    DATA_BENCH = range(1_300_000, 1_400_000)

    @property
    def start(self) -> int:
        """The first seed."""
        return self.value.start

"""A cloud file that may be written again while one looks at it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from megrasp_core.pointcloud import Cloud

__all__ = ["CloudFile"]


class CloudFile:
    """Reads a file, and knows whether it has changed since."""

    def __init__(self, path: Path, read: Callable[[Path], Cloud]) -> None:
        """Take a path and what reads it; nothing is read yet."""
        self.path = path
        self._read = read
        self._seen: tuple[int, int] | None = None

    def read(self) -> Cloud:
        """The cloud as the file has it now.

        Raises:
            CloudError: it cannot be read.
        """
        self._seen = self._state()
        return self._read(self.path)

    def changed(self) -> bool:
        """Whether the file is another one than that which was read; a missing one is not."""
        state = self._state()
        return state is not None and state != self._seen

    def _state(self) -> tuple[int, int] | None:
        try:
            stat = self.path.stat()
        except OSError:
            return None
        return stat.st_mtime_ns, stat.st_size

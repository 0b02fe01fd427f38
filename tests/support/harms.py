"""What can happen to a file."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path


def cut(path: Path) -> None:
    """Lose the second half."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def garbage(path: Path) -> None:
    path.write_bytes(b"not what was written here")


def flip(path: Path, at: float = 0.5) -> None:
    """One byte comes back wrong: of an archive, one of its largest member's content, since there
    are bytes between the members that nobody reads.
    """
    content = bytearray(path.read_bytes())
    start, length = 0, len(content)
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            member = max(archive.infolist(), key=lambda info: info.compress_size)
        name, extra = struct.unpack_from("<HH", content, member.header_offset + 26)
        start, length = member.header_offset + 30 + name + extra, member.compress_size
    content[start + int(at * length)] ^= 0xFF
    path.write_bytes(bytes(content))

"""File helpers of the data sets: whole-file writes, reading that notices every damaged byte, and
damaged files moved aside.
"""

from __future__ import annotations

import errno
import io
import json
import os
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from megrasp_core.errors import DataError

T = TypeVar("T")

DAMAGED = "damaged"
"""Folder within a data folder for files that were moved aside; nothing reads from it."""

_MANIFEST = "the manifest of a data set"


class DamagedError(DataError):
    """What a file holds is not what was written, however often it is read.

    Attributes:
        why: the cause alone.
    """

    why: str = ""

    @classmethod
    def of(
        cls, path: Path, why: object, where: str = "", expected: str = "a whole .npz"
    ) -> DamagedError:
        """The error of a file in a data folder, `where` in it."""
        error = cls(
            f"{path} is damaged{where} ({why}); expected {expected}. `megrasp data verify "
            "--repair` moves damaged files of a data folder aside, then the command that made "
            "them makes them anew."
        )
        error.why = str(why)
        return error


def write_bytes(path: Path, data: bytes) -> None:
    """Writes the whole file or nothing: neither a killed process nor a full disk leaves half a
    file under this name.

    Raises:
        OSError: with the file's name; what was there before is still there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            # Some disks say only now that they are full; and after a power cut the new name must
            # not stand for a file whose bytes never arrived.
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        # A failed write does not name its file.
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_leftovers(folder: Path, age: float) -> None:
    """Deletes what killed runs were writing below `folder`, where it is older than `age` (s)."""
    for path in leftovers(folder):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime >= age:
                path.unlink()


def leftovers(folder: Path) -> list[Path]:
    """Unfinished files below `folder`; those of a run at work among them."""
    return sorted(folder.rglob(".*.part"))


def set_aside(path: Path, folder: Path) -> Path:
    """Moves a damaged file of a data folder to `<folder>/damaged/`, where nothing is ever
    replaced; its new path.
    """
    wanted = folder / DAMAGED / path.relative_to(folder)
    wanted.parent.mkdir(parents=True, exist_ok=True)
    target, number = wanted, 0
    while target.exists():
        number += 1
        target = wanted.with_name(f"{wanted.name}.{number}")
    return path.rename(target)


def listed(paths: Iterable[Path]) -> str:
    """Names of files for a message, not too many."""
    names = [str(path) for path in paths]
    more = f" and {len(names) - 10} more" if len(names) > 10 else ""
    return ", ".join(names[:10]) + more


def packed_npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A compressed .npz; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a compressed .npz as a whole."""
    write_bytes(path, packed_npz(arrays))


class NpzFile(Mapping[str, np.ndarray]):
    """An .npz file: array name -> array, read when asked for.

    Unlike numpy's, it compares the checksum of every array that is read.

    Raises:
        DamagedError: the file, or the array asked for, is damaged.
        OSError: it cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._zip = self._checked(lambda: zipfile.ZipFile(path))
        self.files = [name.removesuffix(".npy") for name in self._zip.namelist()]

    def __getitem__(self, key: str) -> np.ndarray:
        try:
            member = self._zip.getinfo(f"{key}.npy")
        except KeyError:
            # The name may be what is damaged.
            bad = self._checked(self._zip.testzip)
            if bad is not None:
                raise DamagedError.of(self.path, f"the checksum of {bad} is wrong") from None
            raise
        data = self._checked(lambda: self._zip.read(member))
        return self._checked(lambda: np.load(io.BytesIO(data), allow_pickle=False))

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)

    def __enter__(self) -> NpzFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def _checked(self, read: Callable[[], T]) -> T:
        try:
            return read()
        except MemoryError:
            raise
        except Exception as error:
            # Damaged bytes make zipfile, zlib and numpy raise nearly anything, also a seek to
            # where no file can be; what else the system reports is not about the bytes.
            if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
                raise OSError(error.errno, error.strerror, str(self.path)) from error
            raise DamagedError.of(self.path, str(error) or type(error).__name__) from error


def open_npz(path: Path) -> NpzFile:
    """Opens a .npz for reading.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        return NpzFile(path)
    except FileNotFoundError:
        raise DataError(
            f"no file {path}; expected an .npz of a data set. Check the folder given."
        ) from None


def write_json(path: Path, value: Any) -> None:
    """Writes indented JSON as a whole."""
    write_bytes(path, (json.dumps(value, indent=1, sort_keys=True) + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """Reads the JSON object of a manifest.

    Raises:
        DataError: the file is missing.
        DamagedError: it holds something else.
    """
    try:
        value = json.loads(path.read_text())
    except FileNotFoundError:
        raise DataError(f"no file {path}; expected a data set folder. Check the path.") from None
    except ValueError as error:
        raise DamagedError.of(path, error, expected=_MANIFEST) from error
    if not isinstance(value, dict):
        raise DamagedError.of(path, f"it holds a {type(value).__name__}", expected=_MANIFEST)
    return value


def text_array(value: str) -> np.ndarray:
    """A text as uint8, the only way to keep one in an .npz without pickling."""
    return np.frombuffer(value.encode(), np.uint8)


def text_of(array: np.ndarray) -> str:
    """The text kept by `text_array`."""
    return array.tobytes().decode()

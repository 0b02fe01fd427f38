"""Small file helpers of the data sets: whole-file writes and clear errors on damaged files."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError


def write_bytes(path: Path, data: bytes) -> None:
    """Writes the whole file or nothing: a killed process leaves no half file behind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    temporary.write_bytes(data)
    temporary.replace(path)


def packed_npz(arrays: dict[str, np.ndarray]) -> bytes:
    """A compressed .npz; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes a compressed .npz as a whole."""
    write_bytes(path, packed_npz(arrays))


def open_npz(path: Path) -> np.lib.npyio.NpzFile:
    """Opens a .npz for reading.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        return np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise DataError(
            f"no file {path}; expected an .npz of a data set. Check the folder given."
        ) from None
    except (zipfile.BadZipFile, ValueError, OSError, EOFError) as error:
        raise DataError(
            f"{path} is damaged ({error}); expected an .npz of a data set. Delete it and run the "
            "generator again: it makes only what is missing."
        ) from error


def write_json(path: Path, value: Any) -> None:
    """Writes indented JSON as a whole."""
    write_bytes(path, (json.dumps(value, indent=1, sort_keys=True) + "\n").encode())


def read_json(path: Path) -> Any:
    """Reads JSON.

    Raises:
        DataError: the file is missing or no JSON.
    """
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise DataError(f"no file {path}; expected a data set folder. Check the path.") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise DataError(
            f"{path} is no JSON ({error}); expected a manifest written by the generator. Restore "
            "the file."
        ) from error


def text_array(value: str) -> np.ndarray:
    """A text as uint8, the only way to keep one in an .npz without pickling."""
    return np.frombuffer(value.encode(), np.uint8)


def text_of(array: np.ndarray) -> str:
    """The text kept by `text_array`."""
    return array.tobytes().decode()

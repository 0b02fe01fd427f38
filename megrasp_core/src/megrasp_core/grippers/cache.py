"""Results that cost time, kept on disk under a hash of everything they were computed from.

The folder is `$MEGRASP_CACHE`, else `$XDG_CACHE_HOME/megrasp`, else `~/.cache/megrasp`; an empty
`MEGRASP_CACHE` or `off` switches the cache off. What is read is bit for bit what was computed. A
damaged file is computed again, a folder that cannot be written is done without.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

VARIABLE = "MEGRASP_CACHE"
SUFFIX = ".cache"
# The oldest files go when the folder holds more than this (bytes), a share at a time.
LIMIT = 256 * 2**20
KEPT_SHARE = 0.8
DIGEST_SIZE = hashlib.sha256().digest_size

_log = logging.getLogger(__name__)

Arrays = dict[str, NDArray]


def cache_folder() -> Path | None:
    """Return the folder of cached results, None when the cache is off."""
    given = os.environ.get(VARIABLE)
    if given is not None:
        return None if given.strip().lower() in ("", "off") else Path(given).absolute()
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        return (base if base.is_absolute() else Path.home() / ".cache") / "megrasp"
    except RuntimeError:
        return None


def recalled(
    kind: str, inputs: Iterable[NDArray | str | float], make: Callable[[], Mapping[str, NDArray]]
) -> Arrays:
    """Return the arrays that `make` computes from `inputs`, from the cache if they are there.

    `inputs` must hold all that the result depends on; `kind` tells apart what is computed.
    """
    folder = cache_folder()
    if folder is None:
        return dict(make())
    key = _key(inputs)
    file = folder / kind / f"{key}{SUFFIX}"
    found = _read(file)
    if found is not None:
        return found
    made = {name: np.ascontiguousarray(array) for name, array in make().items()}
    _write(file, made)
    if int(key[0], 16) == 0:
        _prune(file.parent)
    return made


def _key(inputs: Iterable[NDArray | str | float]) -> str:
    digest = hashlib.sha256()
    for value in inputs:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(f"{value!r};".encode())
    return digest.hexdigest()[:32]


def _read(file: Path) -> Arrays | None:
    try:
        content = file.read_bytes()
    except OSError:
        return None
    digest, body = content[:DIGEST_SIZE], content[DIGEST_SIZE:]
    try:
        if hashlib.sha256(body).digest() != digest:
            raise ValueError("its checksum is wrong")
        found = load(body)
    except (SafetensorError, ValueError, KeyError) as error:
        _log.warning("%s is damaged (%s); it is computed again", file, error)
        return None
    with suppress(OSError):
        os.utime(file)
    return found


def _write(file: Path, arrays: Arrays) -> None:
    """Write to a file of its own, then move: readers see all of it or nothing."""
    body = save(arrays)
    unfinished: str | None = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as out:
            unfinished = out.name
            out.write(hashlib.sha256(body).digest() + body)
        os.replace(unfinished, file)
    except OSError as error:
        _warn_once(str(file.parent), str(error))
        if unfinished is not None:
            Path(unfinished).unlink(missing_ok=True)


@lru_cache
def _warn_once(folder: str, error: str) -> None:
    _log.warning(
        "cannot keep results in %s (%s); set %s to a folder that can be written, or to off",
        folder, error, VARIABLE,
    )  # fmt: skip


def _prune(folder: Path) -> None:
    """Remove the files that have not been used for longest, where there are too many."""
    try:
        files = [(entry.stat(), entry.path) for entry in os.scandir(folder) if entry.is_file()]
        size = sum(stat.st_size for stat, _ in files)
        if size <= LIMIT:
            return
        for stat, path in sorted(files, key=lambda file: file[0].st_mtime):
            if size <= KEPT_SHARE * LIMIT:
                break
            os.unlink(path)
            size -= stat.st_size
    except OSError as error:
        _log.debug("pruning %s: %s", folder, error)

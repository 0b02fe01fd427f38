"""Writes data set folders so that no accident costs a finished scene.

A scene's file is written as a whole, and deleted only once its shard is on the disk: a killed
process loses the scene it was making and nothing else.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError

from .files import (
    DamagedError,
    open_npz,
    read_json,
    remove_leftovers,
    text_array,
    write_json,
    write_npz,
)
from .integrity import check_scenes, move_aside
from .records import SceneRecord
from .scene_dataset import FORMAT, record_arrays, scene_files, scene_index, scene_name

log = logging.getLogger(__name__)


class SceneWriter:
    """Adds scenes to a data set folder and gathers them into shards. One writer a folder.

    Damaged files that it comes across are moved to `<folder>/damaged/`, and their scenes count as
    missing.

    Args:
        folder: made if missing; an existing data set is continued.
        manifest: config and versions; must equal those of an existing data set.
        shard_size: scenes a shard.

    Raises:
        DataError: the folder holds a data set made with another config, its manifest is damaged,
            or another run is writing to it.
        OSError: the folder cannot be written.
    """

    def __init__(self, folder: Path, manifest: dict[str, Any], shard_size: int = 64) -> None:
        self.folder = Path(folder)
        self._shard_size = shard_size
        self._manifest = {"format": FORMAT, **json.loads(json.dumps(manifest))}
        path = self.folder / "manifest.json"
        if path.exists():
            before = read_json(path)
            changed = sorted(
                key
                for key in {*before, *self._manifest} - {"counts", "versions"}
                if before.get(key) != self._manifest.get(key)
            )
            if changed:
                raise DataError(
                    f"{self.folder} holds a data set that differs in {', '.join(changed)}; "
                    "expected the same configuration to continue it. Give another --out, or the "
                    "former options."
                )
        (self.folder / "scenes").mkdir(parents=True, exist_ok=True)
        (self.folder / "shards").mkdir(parents=True, exist_ok=True)
        self._unlock = weakref.finalize(self, lock(self.folder))
        remove_leftovers(self.folder, age=0.0)
        self._done: set[str] = set()
        for shard in scene_index(self.folder)[1]:
            self._put_aside(shard)
        index, _ = scene_index(self.folder)
        self._done.update(index)
        self._settle({name: file for name, (file, _) in index.items()})
        self._write_manifest()

    def __contains__(self, seed: int) -> bool:
        return scene_name(seed) in self._done

    def __len__(self) -> int:
        return len(self._done)

    def add(self, record: SceneRecord) -> None:
        """Writes one scene; a full set of loose scenes becomes a shard.

        Raises:
            OSError: the scene could not be written. Where only the shard could not, its scenes
                stay as they are, and the next scene tries again.
        """
        write_npz(self.folder / "scenes" / f"{record.name}.npz", record_arrays(record))
        self._done.add(record.name)
        try:
            self._gather()
        except OSError as error:
            log.warning("no shard was made: %s; its scenes lie in %s/scenes", error, self.folder)

    def close(self) -> None:
        """Brings the manifest's counts up to date and lets other writers in; loose scenes stay
        loose.
        """
        try:
            self._write_manifest()
        except OSError as error:
            log.warning("the counts in the manifest are old: %s", error)
        self._unlock()

    def _settle(self, files: dict[str, Path]) -> None:
        """Moves damaged loose scenes aside, and deletes those that their shard holds too, since a
        kill came between; `files`: where a reader finds each scene.
        """
        whole: dict[Path, list[str]] = {}
        for loose in scene_files(self.folder)[0]:
            shard = files[loose.stem]
            if shard == loose:
                self._put_aside(loose)
                continue
            if shard not in whole:
                whole[shard] = check_scenes(shard, _no_problem)[1]
            if loose.stem in whole[shard]:
                loose.unlink()

    def _put_aside(self, path: Path) -> None:
        """Moves a file that cannot be read aside; its scenes are missing then."""
        finding, _ = check_scenes(path, _no_problem)
        if finding is not None:
            self._done.difference_update(finding.lost)
            log.warning("%s; moved to %s", finding, move_aside(finding, self.folder))

    def _gather(self) -> None:
        loose = scene_files(self.folder)[0]
        if len(loose) < self._shard_size:
            return
        arrays: dict[str, np.ndarray] = {}
        files: list[Path] = []
        for path in loose:
            try:
                with open_npz(path) as file:
                    arrays.update({f"{path.stem}/{key}": file[key] for key in file})
            except DamagedError:
                self._put_aside(path)
            else:
                files.append(path)
            if len(files) == self._shard_size:
                break
        else:
            return
        arrays["names"] = text_array("\n".join(path.stem for path in files))
        write_npz(self.folder / "shards" / f"shard_{self._free_number():05d}.npz", arrays)
        # A kill between the two leaves scenes in both places; readers take the shard's.
        for path in files:
            path.unlink()
        self._write_manifest()

    def _free_number(self) -> int:
        """Above those of all shards, of those too that were moved aside or lost."""
        names = (path.name for path in self.folder.rglob("shard_*.npz*"))
        numbers = [name.removeprefix("shard_").split(".")[0] for name in names]
        return max((int(number) for number in numbers if number.isdigit()), default=-1) + 1

    def _write_manifest(self) -> None:
        counts = {"scenes": len(self._done)}
        write_json(self.folder / "manifest.json", {**self._manifest, "counts": counts})


def _no_problem(_: SceneRecord) -> list[str]:
    return []


def lock(folder: Path) -> Callable[[], None]:
    """Keeps other writers out of a folder until the returned function is called, or the process
    ends, however it ends.

    Raises:
        DataError: another process writes to the folder.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise DataError(
            f"another run is writing to {folder}; expected one at a time. Wait until it has "
            "ended, or give another --out."
        ) from None
    except OSError as error:
        log.warning("%s cannot be locked (%s); take care that one run writes to it", folder, error)
    return lambda: os.close(handle)

"""Scene records on disk: one file a scene while running, shards of many once enough are there, and
a manifest.

    manifest.json                 config, versions, counts
    scenes/scene_0000000007.npz   finished scenes, not yet in a shard
    shards/shard_00000.npz        `shard_size` scenes each

A scene's file is written as a whole, so a killed process loses the scene it was making and nothing
else; a data set folder can be read while it grows.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.datasets.files import (
    open_npz,
    read_json,
    text_array,
    text_of,
    write_json,
    write_npz,
)
from megrasp_core.datasets.records import (
    GripperLabels,
    SceneRecord,
    bin_fields,
    bin_from_fields,
)
from megrasp_core.errors import DataError

FORMAT = 2
READABLE = (1, 2)
"""Format 1 keeps the inner size of a bin and nothing else of it."""


def scene_name(seed: int) -> str:
    """Name of the scene that a seed makes."""
    return f"scene_{seed:010d}"


def record_arrays(record: SceneRecord, prefix: str = "") -> dict[str, np.ndarray]:
    """A record as plain arrays, keys starting with `prefix`."""
    grippers = sorted(record.labels)
    labels = [record.labels[name] for name in grippers]
    reasons = sorted({str(reason) for part in labels for reason in part.reason})
    code = {reason: index for index, reason in enumerate(reasons)}
    joined = GripperLabels.joined(labels)
    meta = {
        "name": record.name,
        "seed": record.seed,
        "object_names": list(record.object_names),
        "bin": bin_fields(record.bin),
        "grippers": grippers,
        "counts": [len(part) for part in labels],
        "reasons": reasons,
    }
    arrays = {
        "meta": text_array(json.dumps(meta, sort_keys=True)),
        "object_poses": record.object_poses.astype(np.float32),
        "obstacle": record.obstacle.astype(bool),
        "points": record.points.astype(np.float16),
        "normals": record.normals.astype(np.int8),
        "on_plane": record.on_plane.astype(bool),
        "view": np.stack([record.sensor, record.gravity]).astype(np.float32),
        "world_from_tcp": joined.world_from_tcp,
        "object": joined.object,
        "label": joined.label,
        "kind": joined.kind,
        "reason": np.array([code[str(reason)] for reason in joined.reason], np.uint8),
    }
    return {prefix + key: value for key, value in arrays.items()}


def record_from_arrays(file: Any, prefix: str = "") -> SceneRecord:
    """The record kept by `record_arrays`; `file` is a mapping or an open .npz."""
    meta = json.loads(text_of(file[prefix + "meta"]))
    view = file[prefix + "view"]
    reasons = np.array([*meta["reasons"], ""], np.str_)
    pose, owner = file[prefix + "world_from_tcp"], file[prefix + "object"]
    label, kind = file[prefix + "label"], file[prefix + "kind"]
    reason = reasons[file[prefix + "reason"]]
    labels: dict[str, GripperLabels] = {}
    start = 0
    for name, count in zip(meta["grippers"], meta["counts"]):
        part = slice(start, start + count)
        labels[name] = GripperLabels(
            pose[part], owner[part], label[part], kind[part], reason[part]
        )
        start += count
    return SceneRecord(
        name=meta["name"],
        seed=int(meta["seed"]),
        object_names=tuple(meta["object_names"]),
        object_poses=file[prefix + "object_poses"],
        obstacle=file[prefix + "obstacle"],
        bin=bin_from_fields(meta["bin"] if "bin" in meta else meta["bin_inner"]),
        points=file[prefix + "points"],
        normals=file[prefix + "normals"],
        on_plane=file[prefix + "on_plane"],
        sensor=view[0],
        gravity=view[1],
        labels=labels,
    )


class SceneWriter:
    """Adds scenes to a data set folder and gathers them into shards. One writer a folder.

    Args:
        folder: made if missing; an existing data set is continued.
        manifest: config and versions; must equal those of an existing data set.
        shard_size: scenes a shard.

    Raises:
        DataError: the folder holds a data set made with another config.
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
                    "expected the same "
                    "configuration to continue it. Give another --out, or the former options."
                )
        (self.folder / "scenes").mkdir(parents=True, exist_ok=True)
        (self.folder / "shards").mkdir(parents=True, exist_ok=True)
        self._done = set(_index(self.folder))
        self._write_manifest()

    def __contains__(self, seed: int) -> bool:
        return scene_name(seed) in self._done

    def __len__(self) -> int:
        return len(self._done)

    def add(self, record: SceneRecord) -> None:
        """Writes one scene; a full set of loose scenes becomes a shard."""
        write_npz(self.folder / "scenes" / f"{record.name}.npz", record_arrays(record))
        self._done.add(record.name)
        loose = sorted((self.folder / "scenes").glob("scene_*.npz"))
        if len(loose) >= self._shard_size:
            self._make_shard(loose[: self._shard_size])
            self._write_manifest()

    def close(self) -> None:
        """Brings the manifest's counts up to date; loose scenes stay loose."""
        self._write_manifest()

    def _make_shard(self, files: list[Path]) -> None:
        arrays: dict[str, np.ndarray] = {}
        for path in files:
            with open_npz(path) as file:
                arrays.update({f"{path.stem}/{key}": file[key] for key in file.files})
        arrays["names"] = text_array("\n".join(path.stem for path in files))
        number = len(list((self.folder / "shards").glob("shard_*.npz")))
        write_npz(self.folder / "shards" / f"shard_{number:05d}.npz", arrays)
        # A kill between the two leaves scenes in both places; readers take the shard's.
        for path in files:
            path.unlink()

    def _write_manifest(self) -> None:
        counts = {"scenes": len(self._done)}
        write_json(self.folder / "manifest.json", {**self._manifest, "counts": counts})


class SceneDataset(Sequence[SceneRecord]):
    """Reads one or more data set folders, sorted by scene name within each; records are read when
    asked for.

    Args:
        folders: data set folders, as written by `SceneWriter`.

    Raises:
        DataError: a folder holds no data set.
    """

    def __init__(self, folders: str | Path | Iterable[str | Path]) -> None:
        if isinstance(folders, (str, Path)):
            folders = [folders]
        self.folders = [Path(folder) for folder in folders]
        self.manifests: list[dict[str, Any]] = []
        self._entries: list[tuple[Path, Path, str, str]] = []
        for folder in self.folders:
            self.manifests.append(_manifest(folder))
            for name, (path, prefix) in sorted(_index(folder).items()):
                self._entries.append((folder, path, prefix, name))
        self._open: tuple[Path, Any] | None = None

    @property
    def names(self) -> list[str]:
        """Scene names, in order."""
        return [entry[3] for entry in self._entries]

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> SceneRecord:  # type: ignore[override]
        folder, path, prefix, name = self._entries[index]
        if not path.exists():
            # The generator has moved the scene into a shard since this data set was opened.
            moved = _index(folder).get(name)
            if moved is None:
                raise DataError(
                    f"{folder} no longer holds {name}; expected {path}. Was the file deleted?"
                )
            path, prefix = moved
            self._entries[index] = (folder, path, prefix, name)
        if self._open is None or self._open[0] != path:
            self._open = (path, open_npz(path))
        try:
            return record_from_arrays(self._open[1], prefix)
        except (KeyError, ValueError, OSError, zipfile.BadZipFile, zlib.error) as error:
            raise DataError(
                f"{path} is damaged at {name} ({error}); expected a scene record. Delete the file "
                "and run the generator again."
            ) from error

    def __iter__(self) -> Iterator[SceneRecord]:
        for index in range(len(self)):
            yield self[index]


def _manifest(folder: Path) -> dict[str, Any]:
    manifest = read_json(folder / "manifest.json")
    if manifest.get("format") not in READABLE:
        raise DataError(
            f"{folder} has format {manifest.get('format')!r}; expected one of {READABLE}. "
            "Make the data set again."
        )
    return manifest


def _index(folder: Path) -> dict[str, tuple[Path, str]]:
    """Scene name -> (file, key prefix)."""
    found: dict[str, tuple[Path, str]] = {}
    for path in sorted((folder / "scenes").glob("scene_*.npz")):
        found[path.stem] = (path, "")
    for path in sorted((folder / "shards").glob("shard_*.npz")):
        with open_npz(path) as file:
            for name in text_of(file["names"]).splitlines():
                found[name] = (path, f"{name}/")
    return found

"""Scene records on disk: one file a scene while running, shards of many once enough are there, and
a manifest.

    manifest.json                 config, versions, counts
    scenes/scene_0000000007.npz   finished scenes, not yet in a shard
    shards/shard_00000.npz        `shard_size` scenes each

`scene_writer.py` writes them; a data set folder can be read while it grows.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError

from .codec import TextCodes, split, texts_of
from .files import DamagedError, NpzFile, listed, open_npz, read_json, text_array, text_of
from .records import GripperLabels, SceneRecord, bin_fields, bin_from_fields

FORMAT = 2
READABLE = (1, 2)
"""Format 1 keeps the inner size of a bin and nothing else of it."""


SCENE_NAME = r"scene_(\d{10,})"
"""Names that `scene_name` makes; times in nanoseconds have more than ten digits."""


def scene_name(seed: int) -> str:
    """Name of the scene that a seed makes."""
    return f"scene_{seed:010d}"


def record_arrays(record: SceneRecord, prefix: str = "") -> dict[str, np.ndarray]:
    """A record as plain arrays, keys starting with `prefix`."""
    grippers = sorted(record.labels)
    labels = [record.labels[name] for name in grippers]
    joined = GripperLabels.joined(labels)
    reasons = TextCodes.sorted(joined.reason)
    meta = {
        "name": record.name,
        "seed": record.seed,
        "object_names": list(record.object_names),
        "bin": bin_fields(record.bin),
        "grippers": grippers,
        "counts": [len(part) for part in labels],
        "reasons": reasons.names,
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
        "reason": reasons.codes(joined.reason).astype(np.uint8),
        "extra": joined.extra,
        "robust": joined.robust,
    }
    return {prefix + key: value for key, value in arrays.items()}


def record_from_arrays(file: Any, prefix: str = "") -> SceneRecord:
    """The record kept by `record_arrays`; `file` is a mapping or an open .npz."""
    meta = json.loads(text_of(file[prefix + "meta"]))
    view = file[prefix + "view"]
    label = file[prefix + "label"]
    # Scenes made before they were kept have no such arrays.
    extra, robust = (
        file[prefix + name] if prefix + name in file else GripperLabels.not_tried(len(label))
        for name in ("extra", "robust")
    )
    joined = GripperLabels(
        world_from_tcp=file[prefix + "world_from_tcp"],
        object=file[prefix + "object"],
        label=label,
        kind=file[prefix + "kind"],
        reason=texts_of(meta["reasons"], file[prefix + "reason"]),
        extra=extra,
        robust=robust,
    )
    labels = split(joined, dict(zip(meta["grippers"], meta["counts"], strict=True)))
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


class SceneDataset(Sequence[SceneRecord]):
    """Reads one or more data set folders, sorted by scene name within each; records are read when
    asked for.

    Args:
        folders: data set folders, as written by `SceneWriter`.

    Raises:
        DataError: a folder holds no data set, or shards are damaged; all of them are named.
    """

    def __init__(self, folders: str | Path | Iterable[str | Path]) -> None:
        if isinstance(folders, (str, Path)):
            folders = [folders]
        self.folders = [Path(folder) for folder in folders]
        self.manifests: list[dict[str, Any]] = []
        self._entries: list[tuple[Path, Path, str, str]] = []
        damaged: list[Path] = []
        for folder in self.folders:
            self.manifests.append(read_manifest(folder))
            found, without_names = scene_index(folder)
            damaged.extend(without_names)
            for name, (path, prefix) in sorted(found.items()):
                self._entries.append((folder, path, prefix, name))
        if damaged:
            raise DataError(
                f"damaged: {listed(damaged)}; expected whole shards. Run `megrasp data verify "
                "--repair --out` on that folder to move them aside, then the command that made "
                "the data set: it makes their scenes anew."
            )
        self._open: tuple[Path, NpzFile] | None = None

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
            moved = scene_index(folder)[0].get(name)
            if moved is None:
                raise DataError(
                    f"{folder} no longer holds {name}; expected {path}. Was the file deleted?"
                )
            path, prefix = moved
            self._entries[index] = (folder, path, prefix, name)
        if self._open is None or self._open[0] != path:
            self._open = (path, open_npz(path))
        return read_record(self._open[1], prefix, name)

    def __iter__(self) -> Iterator[SceneRecord]:
        for index in range(len(self)):
            yield self[index]


def read_record(file: NpzFile, prefix: str, name: str) -> SceneRecord:
    """The record of a scene from an open file.

    Raises:
        DamagedError: the file holds something else there.
    """
    try:
        record = record_from_arrays(file, prefix)
        if record.name != name:
            raise ValueError(f"it is named {record.name} within")
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise DamagedError.of(file.path, error, f" at {name}", "a scene record") from error
    return record


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a data set.

    Raises:
        DataError: it is missing or damaged, or of another version.
    """
    manifest = read_json(folder / "manifest.json")
    if manifest.get("format") not in READABLE:
        raise DataError(
            f"{folder} has format {manifest.get('format')!r}; expected one of {READABLE}. "
            "Make the data set again."
        )
    return manifest


def scene_files(folder: Path) -> tuple[list[Path], list[Path]]:
    """Files of single scenes, and shards."""
    # In this order: a scene that a generator at work moves meanwhile is then found in both.
    loose = sorted((folder / "scenes").glob("scene_*.npz"))
    return loose, sorted((folder / "shards").glob("shard_*.npz"))


def shard_names(file: NpzFile) -> list[str]:
    """Names of the scenes in an open shard.

    Raises:
        DamagedError: it does not tell.
    """
    try:
        return text_of(file["names"]).splitlines()
    except (KeyError, ValueError) as error:
        raise DamagedError.of(file.path, error) from error


def scene_index(folder: Path) -> tuple[dict[str, tuple[Path, str]], dict[Path, DamagedError]]:
    """Scene name -> (file, key prefix), and the shards that do not tell what they hold."""
    loose, shards = scene_files(folder)
    found = {path.stem: (path, "") for path in loose}
    damaged: dict[Path, DamagedError] = {}
    for path in shards:
        try:
            with open_npz(path) as file:
                found.update({name: (path, f"{name}/") for name in shard_names(file)})
        except DamagedError as error:
            damaged[path] = error
    return found, damaged

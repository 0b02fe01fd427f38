"""Device packs: what training uses of many scenes in one small file that is mapped, not read.

A pack is a safetensors file of plain arrays: the scenes' points one after another, their labels
one after another, and where each scene begins. Of a surface it keeps the nodes of inference first,
then more points around them, so that training still draws its nodes at random; neighbours and
graphs are found where it is read. `device_packing.py` writes packs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from megrasp_core.errors import DataError

from .codec import split, texts_of, unpack_poses
from .files import text_of
from .packed_scene import PackedScene
from .records import GripperLabels, bin_from_fields

FORMAT = "megrasp device pack 1"
SUFFIX = ".mgpack"
LAYOUT = {
    "origin": ("F32", 3),
    "step": ("F32", 0),
    "gravity": ("F32", 3),
    "inference": ("I32", 0),
    "point_start": ("I64", 0),
    "label_start": ("I64", 0),
    "points": ("I16", 3),
    "normals": ("I8", 2),
    "on_plane": ("U8", 0),
    "position": ("I16", 3),
    "quaternion": ("I16", 4),
    "object": ("U8", 0),
    "outcome": ("U8", 0),
    "reason": ("U8", 0),
    "meta": ("U8", 0),
    "sha256": ("U8", 0),
}
"""Type in the file, and columns (0: a vector), of every array."""
OPTIONAL = {"robust": ("I8", 0)}
"""The same of arrays that only some packs have; readers that know none of them get by without.
`meta` keeps the sha256 of each that is there, since the pack's own is of `LAYOUT` alone.
"""
_REPAIR = "Copy the file again, or make it again with `megrasp data pack --device`."


class DevicePack(Sequence[PackedScene]):
    """The scenes of a pack in the order of its sources; a scene is read when asked for.

    Attributes:
        path: the file.
        meta: sources with their manifests, grippers with their hashes, objects, scenes.
        choice: by which settings the nodes of inference were chosen.

    Raises:
        DataError: the file is missing, damaged, no pack, or one of an unknown version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._file = safe_open(self.path, framework="numpy")
            written = (self._file.metadata() or {}).get("format", "")
        except FileNotFoundError:
            raise DataError(f"no file {path}; expected a device pack. Check the path.") from None
        except (SafetensorError, OSError) as error:
            raise DataError(
                f"{path} is no device pack, or a damaged one ({error}). {_REPAIR}"
            ) from error
        if written != FORMAT:
            raise DataError(
                f"{path} has format {written!r}; expected {FORMAT!r}. Pack the data set again "
                "with this version of `megrasp data pack --device`."
            )
        try:
            self._check()
            self.meta: dict[str, Any] = json.loads(text_of(self._file.get_tensor("meta")))
            self.choice: dict[str, float] = self.meta["nodes"]
            if sorted(self.meta.get("optional", {})) != self._optional:
                raise ValueError(f"arrays {self._optional} are there, others were written")
            if len(self.meta["scenes"]) != len(self):
                raise ValueError(f"{len(self.meta['scenes'])} names for {len(self)} scenes")
        except (LookupError, TypeError, ValueError, SafetensorError) as error:
            raise DataError(f"{path} is damaged ({error}). {_REPAIR}") from error

    def _check(self) -> None:
        """Raises ValueError where arrays are missing or do not fit together."""
        names = set(self._file.keys())
        self._optional = sorted(names & set(OPTIONAL))
        rows: dict[str, int] = {}
        wanted = {**LAYOUT, **{name: OPTIONAL[name] for name in self._optional}}
        for name, (kind, columns) in wanted.items():
            if name not in names:
                raise ValueError(f"no array {name}")
            part = self._file.get_slice(name)
            shape = part.get_shape()
            if part.get_dtype() != kind or shape[1:] != ([columns] if columns else []):
                raise ValueError(f"{name} has type {part.get_dtype()} and shape {shape}")
            rows[name] = shape[0]
        self._count = rows["inference"]
        self._point_start, self._label_start, self._inference = (
            self._file.get_tensor(name) for name in ("point_start", "label_start", "inference")
        )
        self._frames = {n: self._file.get_tensor(n) for n in ("origin", "step", "gravity")}
        counts = {
            **dict.fromkeys(("origin", "step", "gravity", "inference"), len(self)),
            **dict.fromkeys(("point_start", "label_start"), len(self) + 1),
            **dict.fromkeys(("points", "normals"), int(self._point_start[-1])),
            "on_plane": -(-int(self._point_start[-1]) // 8),
            **dict.fromkeys(
                ("position", "quaternion", "object", "outcome", "reason", *self._optional),
                int(self._label_start[-1]),
            ),
        }
        wrong = [name for name, count in counts.items() if rows[name] != count]
        if wrong:
            raise ValueError(f"{', '.join(wrong)} do not have the rows that the others call for")
        size = np.diff(self._point_start)
        if self._point_start[0] or self._label_start[0] or (np.diff(self._label_start) < 0).any():
            raise ValueError("labels or points do not begin at 0 or run backwards")
        if (self._inference < 1).any() or (self._inference > size).any():
            raise ValueError("a scene has no nodes, or more nodes than points")

    @property
    def names(self) -> list[str]:
        """Scene names, in order."""
        return [scene["name"] for scene in self.meta["scenes"]]

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> PackedScene:  # type: ignore[override]
        index = range(len(self))[index]
        scene = self.meta["scenes"][index]
        first, last = int(self._point_start[index]), int(self._point_start[index + 1])
        try:
            bits = np.unpackbits(
                self._part("on_plane", first // 8, -(-last // 8)), bitorder="little"
            )
            return PackedScene(
                name=scene["name"],
                seed=int(scene["seed"]),
                object_names=tuple(self.meta["objects"][place] for place in scene["objects"]),
                bin=bin_from_fields(scene["bin"]),
                gravity=self._frames["gravity"][index],
                origin=self._frames["origin"][index].astype(np.float64),
                step=float(self._frames["step"][index]),
                lattice=self._part("points", first, last),
                octahedral=self._part("normals", first, last),
                on_plane=bits[first % 8 :][: last - first].astype(bool),
                inference=int(self._inference[index]),
                choice=self.choice,
                labels=self._labels(index),
            )
        except (LookupError, TypeError, ValueError) as error:
            raise DataError(
                f"{self.path} is damaged at {scene.get('name', index)} ({error}). {_REPAIR}"
            ) from error

    def _part(self, name: str, first: int, last: int) -> np.ndarray:
        """Rows of an array: only their pages of the file are touched."""
        return self._file.get_slice(name)[first:last]

    def _labels(self, index: int) -> dict[str, GripperLabels]:
        counts = self.meta["scenes"][index]["grippers"]
        first, last = int(self._label_start[index]), int(self._label_start[index + 1])
        if sum(counts.values()) != last - first:
            raise ValueError(f"{sum(counts.values())} labels named, {last - first} kept")
        if first == last:
            return {name: GripperLabels.empty() for name in counts}
        pose = unpack_poses(
            self._part("position", first, last),
            self._part("quaternion", first, last),
            float(self._frames["step"][index]),
            self._frames["origin"][index],
        )
        outcome = self._part("outcome", first, last).astype(np.int8)
        owner = self._part("object", first, last).astype(np.int16)
        robust = GripperLabels.not_tried(last - first)
        if "robust" in self._optional:
            robust = self._part("robust", first, last)
        joined = GripperLabels(
            world_from_tcp=pose.astype(np.float32),
            object=owner,
            label=outcome & 1,
            kind=outcome >> 1,
            reason=texts_of(self.meta["reasons"], self._part("reason", first, last)),
            extra=GripperLabels.not_tried(last - first),
            robust=robust,
        )
        return split(joined, counts)


def verify_pack(path: str | Path) -> list[str]:
    """Reads all of a pack and returns what is wrong with it, one line each; empty when all is
    well.

    Raises:
        DataError: the file cannot be opened as a pack.
    """
    pack = DevicePack(path)
    problems: list[str] = []
    arrays = {name: pack._file.get_tensor(name) for name in LAYOUT}
    if arrays.pop("sha256").tobytes() != digest(arrays):
        problems.append(f"{path}: the content does not match its sha256. {_REPAIR}")
    for name, expected in pack.meta.get("optional", {}).items():
        if digest({name: pack._file.get_tensor(name)}).hex() != expected:
            problems.append(f"{path}: {name} does not match its sha256. {_REPAIR}")
    for index in range(len(pack)):
        try:
            pack[index]
        except DataError as error:
            problems.append(str(error))
    return problems


def digest(arrays: dict[str, np.ndarray]) -> bytes:
    """SHA-256 over names and contents of the arrays."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        sha.update(name.encode())
        sha.update(np.ascontiguousarray(arrays[name]).data)
    return sha.digest()

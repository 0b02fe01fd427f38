"""The grasp library: free-space labels for every (gripper, object), resumable, and packed into one
small file.

While running, one file a pair lies in `<folder>/<gripper>/`; `pack_library` gathers them into one
file a gripper, with poses rounded to 0.01 mm and 0.003 degrees and the quality to 1/255.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from megrasp_core.datasets.files import (
    open_npz,
    packed_npz,
    text_array,
    text_of,
    write_bytes,
    write_npz,
)
from megrasp_core.datasets.records import GraspSet
from megrasp_core.errors import DataError
from megrasp_core.grippers import load_gripper

_METRE = 1e-5
_QUATERNION = 32767.0
_PACKED = "megrasp grasp library 2"


class GraspLibrary:
    """Grasp sets by (gripper, object name).

    Args:
        sets: the grasp sets; a later one of the same pair replaces an earlier one.
    """

    def __init__(self, sets: Iterable[GraspSet] = ()) -> None:
        self._sets = {(entry.gripper, entry.object_name): entry for entry in sets}

    def __len__(self) -> int:
        return len(self._sets)

    def __iter__(self) -> Iterator[GraspSet]:
        """Grasp sets sorted by gripper and object."""
        for key in sorted(self._sets):
            yield self._sets[key]

    def get(self, gripper: str, object_name: str) -> GraspSet | None:
        """The set of a pair, None where it was never labelled."""
        return self._sets.get((gripper, object_name))

    @property
    def grippers(self) -> list[str]:
        """Names of the grippers, sorted."""
        return sorted({gripper for gripper, _ in self._sets})

    def objects(self, grippers: Iterable[str] | None = None) -> list[str]:
        """Names of the objects labelled for all of `grippers` (default: all in the library),
        sorted.
        """
        wanted = self.grippers if grippers is None else list(grippers)
        names = {name for _, name in self._sets}
        return sorted(
            name for name in names if all((gripper, name) in self._sets for gripper in wanted)
        )


def pair_file(folder: Path, gripper: str, object_name: str) -> Path:
    """Where the labels of a pair lie in a library folder."""
    return Path(folder) / gripper / f"{object_name.replace('/', '__')}.npz"


def write_grasp_set(folder: Path, entry: GraspSet) -> Path:
    """Writes the labels of one pair as a whole and returns the file."""
    path = pair_file(folder, entry.gripper, entry.object_name)
    write_npz(path, _arrays([entry]))
    return path


def continue_library(library: GraspLibrary, folder: Path) -> int:
    """Writes the pairs that `folder` lacks, so that generation goes on from them; their number.

    Pairs of another version of a gripper are left out, since they would be made otherwise now.
    """
    hashes = {name: load_gripper(name).hash for name in library.grippers}
    taken = [
        entry
        for entry in library
        if entry.gripper_hash == hashes[entry.gripper]
        and not pair_file(folder, entry.gripper, entry.object_name).exists()
    ]
    for entry in taken:
        write_grasp_set(folder, entry)
    return len(taken)


def pack_library(library: GraspLibrary, folder: Path, *, limit: int = 15_000_000) -> int:
    """Writes `<folder>/<gripper>.npz` for every gripper and returns their size in bytes.

    Raises:
        DataError: the files would be larger than `limit` together; nothing is written.
    """
    packed = {
        gripper: packed_npz(_arrays([entry for entry in library if entry.gripper == gripper]))
        for gripper in library.grippers
    }
    size = sum(map(len, packed.values()))
    if size > limit:
        raise DataError(
            f"the packed library has {size} bytes; expected at most {limit}. Pack fewer objects "
            "or lower the number of grasps kept a pair."
        )
    for gripper, data in packed.items():
        write_bytes(folder / f"{gripper}.npz", data)
    return size


def load_library(path: str | Path) -> GraspLibrary:
    """Reads a packed file, a folder of packed files, or a folder that `write_grasp_set` filled.

    Raises:
        DataError: nothing there, or a file is damaged.
    """
    path = Path(path)
    files = sorted(path.rglob("*.npz")) if path.is_dir() else [path]
    if not files:
        raise DataError(
            f"{path} holds no .npz; expected a grasp library. Make one with `megrasp data grasps "
            f"--out {path}`."
        )
    return GraspLibrary(entry for file in files for entry in _read(file))


def _arrays(sets: list[GraspSet]) -> dict[str, np.ndarray]:
    reasons = sorted({str(reason) for entry in sets for reason in entry.reason})
    code = {reason: index for index, reason in enumerate(reasons)}
    meta = {
        "format": _PACKED,
        "reasons": reasons,
        "sets": [
            [e.gripper, e.gripper_hash, e.object_name, e.drawn, e.tried, len(e.success)]
            for e in sets
        ],
    }
    poses = np.concatenate([e.object_from_tcp for e in sets] or [np.zeros((0, 7))])
    if len(poses) and np.abs(poses[:, :3]).max() > 32767 * _METRE:
        raise DataError(
            "a grasp lies more than 0.32 m from its object's centre; expected graspable objects. "
            "Leave larger "
            "objects out of the library."
        )
    return {
        "meta": text_array(json.dumps(meta)),
        "position": np.rint(poses[:, :3] / _METRE).astype(np.int16),
        "quaternion": np.rint(poses[:, 3:] * _QUATERNION).astype(np.int16),
        "success": np.concatenate([e.success for e in sets] or [np.zeros(0, bool)]),
        "quality": np.rint(
            255.0 * np.concatenate([e.quality for e in sets] or [np.zeros(0)])
        ).astype(np.uint8),
        "reason": np.array(
            [code[str(reason)] for entry in sets for reason in entry.reason], np.uint8
        ),
    }


def _read(path: Path) -> Iterator[GraspSet]:
    with open_npz(path) as file:
        try:
            meta = json.loads(text_of(file["meta"]))
            position, quaternion = file["position"], file["quaternion"]
            success, reason = file["success"], file["reason"]
            quality = file["quality"].astype(np.float32) / 255.0
        except (KeyError, ValueError) as error:
            raise DataError(
                f"{path} is no grasp library ({error}); expected a file of `megrasp data grasps` "
                "or `pack`."
            ) from error
    if meta.get("format") != _PACKED:
        raise DataError(f"{path} has format {meta.get('format')!r}; expected {_PACKED!r}.")
    poses = np.hstack([position * _METRE, quaternion / _QUATERNION])
    norm = np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    poses[:, 3:] /= np.maximum(norm, 1e-9)
    names = np.array([*meta["reasons"], ""], np.str_)
    start = 0
    for gripper, digest, object_name, drawn, tried, count in meta["sets"]:
        part = slice(start, start + count)
        yield GraspSet(
            gripper,
            digest,
            object_name,
            poses[part],
            success[part],
            quality[part],
            names[reason[part]],
            drawn,
            tried,
        )
        start += count


def thinned(entry: GraspSet, failures: int) -> GraspSet:
    """The set with all successes and the first `failures` failures, in their order."""
    failed = np.flatnonzero(~entry.success)[:failures]
    keep = np.sort(np.concatenate([np.flatnonzero(entry.success), failed]))
    return replace(
        entry,
        object_from_tcp=entry.object_from_tcp[keep],
        success=entry.success[keep],
        quality=entry.quality[keep],
        reason=entry.reason[keep],
    )

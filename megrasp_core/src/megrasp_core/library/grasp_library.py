"""The grasp library: free-space labels for every (gripper, object), resumable, and packed into one
small file.

While running, one file a pair lies in `<folder>/<gripper>/`; `pack_library` gathers them into one
file a gripper, with poses rounded to 0.01 mm and 0.003 degrees and the quality to 1/255.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from megrasp_core.errors import DataError
from megrasp_core.grippers import load_gripper
from megrasp_core.storage import (
    DamagedError,
    GraspSet,
    TextCodes,
    open_npz,
    pack_positions,
    pack_quaternions,
    packed_npz,
    set_aside,
    text_array,
    text_of,
    texts_of,
    unpack_poses,
    write_bytes,
    write_npz,
)
from megrasp_core.storage.files import DAMAGED, listed

log = logging.getLogger(__name__)

_METRE = 1e-5
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


def find_pair(folder: Path, gripper: str, object_name: str) -> GraspSet | None:
    """The labels that a library folder holds of a pair, None where it has none; a damaged file is
    moved aside.
    """
    path = pair_file(folder, gripper, object_name)
    if not path.exists():
        return None
    try:
        return read_sets(path)[0]
    except DamagedError as error:
        log.warning("%s; moved to %s", error, set_aside(path, Path(folder)))
        return None


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
        and find_pair(folder, entry.gripper, entry.object_name) is None
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


def library_files(path: str | Path) -> list[Path]:
    """The files of a packed library, of a folder of such, or of one that `write_grasp_set` filled.

    Raises:
        DataError: nothing there.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    found = (file.relative_to(path) for file in path.rglob("*.npz"))
    files = sorted(path / file for file in found if DAMAGED not in file.parts)
    if not files:
        raise DataError(
            f"{path} holds no .npz; expected a grasp library. Make one with `megrasp data grasps "
            f"--out {path}`."
        )
    return files


def load_library(path: str | Path) -> GraspLibrary:
    """Reads a packed file, a folder of packed files, or a folder that `write_grasp_set` filled.

    Raises:
        DataError: nothing there, or files are damaged; all of them are named.
    """
    files, sets = library_files(path), []
    damaged: dict[Path, DamagedError] = {}
    for file in files:
        try:
            sets.extend(read_sets(file))
        except DamagedError as error:
            damaged[file] = error
    if len(damaged) > 1:
        raise DataError(
            f"{len(damaged)} of the {len(files)} files of {path} are damaged: {listed(damaged)}; "
            f"expected a grasp library. Run `megrasp data verify --out {path} --repair`, then the "
            "command that made it again."
        )
    for error in damaged.values():
        raise error
    return GraspLibrary(sets)


def _arrays(sets: list[GraspSet]) -> dict[str, np.ndarray]:
    reason = [reason for entry in sets for reason in entry.reason]
    reasons = TextCodes.sorted(reason)
    meta = {
        "format": _PACKED,
        "reasons": reasons.names,
        "sets": [
            [e.gripper, e.gripper_hash, e.object_name, e.drawn, e.tried, len(e.success)]
            for e in sets
        ],
    }
    poses = np.concatenate([e.object_from_tcp for e in sets] or [np.zeros((0, 7))])
    try:
        position = pack_positions(poses[:, :3], _METRE)
    except ValueError as error:
        raise DataError(
            f"{error}, its object's centre; expected graspable objects. Leave larger objects out "
            "of the library."
        ) from error
    return {
        "meta": text_array(json.dumps(meta)),
        "position": position,
        "quaternion": pack_quaternions(poses[:, 3:]),
        "success": np.concatenate([e.success for e in sets] or [np.zeros(0, bool)]),
        "quality": np.rint(
            255.0 * np.concatenate([e.quality for e in sets] or [np.zeros(0)])
        ).astype(np.uint8),
        "reason": reasons.codes(reason).astype(np.uint8),
    }


def read_sets(path: Path) -> list[GraspSet]:
    """The grasp sets of one file.

    Raises:
        DataError: the file is missing, something else, or of another version.
        DamagedError: it is damaged.
    """
    with open_npz(path) as file:
        try:
            meta = json.loads(text_of(file["meta"]))
            written = meta["format"]
        except (KeyError, ValueError, TypeError) as error:
            raise DataError(
                f"{path} is no grasp library ({error}); expected a file of `megrasp data grasps` "
                "or `pack`."
            ) from error
        if written != _PACKED:
            raise DataError(
                f"{path} has format {written!r}; expected {_PACKED!r}. Make it again, in another "
                "folder."
            )
        try:
            poses = unpack_poses(file["position"], file["quaternion"], _METRE)
            success = file["success"]
            quality = file["quality"].astype(np.float32) / 255.0
            reason = texts_of(meta["reasons"], file["reason"])
            sets = meta["sets"]
            counts = [int(entry[5]) for entry in sets]
            shapes = [part.shape for part in (success, quality, reason)]
            if poses.shape != (sum(counts), 7) or set(shapes) != {(sum(counts),)}:
                raise ValueError(f"it does not hold the {sum(counts)} grasps that it counts")
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise DamagedError.of(path, error) from error
    ends = np.cumsum(counts, dtype=int)
    return [
        GraspSet(
            gripper,
            digest,
            object_name,
            poses[end - count : end],
            success[end - count : end],
            quality[end - count : end],
            reason[end - count : end],
            drawn,
            tried,
        )
        for (gripper, digest, object_name, drawn, tried, count), end in zip(sets, ends)
    ]


def with_few_failures(entry: GraspSet, failures: int) -> GraspSet:
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

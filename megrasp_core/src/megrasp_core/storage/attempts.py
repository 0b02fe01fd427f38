"""Attempts of a cell at picking: what the camera saw, the grasp that was tried, what became of it.

A folder of files, one an attempt, named by the time of the attempt: `attempt_<ns>.npz`. Each is
written as a whole (`write_bytes`), so that a killed cell loses the attempt it was writing and
nothing else; the folder has an upper size, for which the oldest go.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix
from megrasp_core.pointcloud import OrientedBox, Plane

from .files import DamagedError, open_npz, remove_leftovers, text_array, text_of, write_npz

log = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

FORMAT = 1
STEP = 1e-4
"""Coordinates of points are kept in steps of this (m), a fifth of the best camera's noise."""
LIMIT = 2 * 10**9
"""Bytes of a folder."""
OLD = 60.0
"""An unfinished file of this age (s) is nobody's any more."""

POSES = ("world_from_tcp", "world_from_gripper", "approach", "retreat")


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """One grasp that was tried. Everything is in one frame; metres, radians.

    Attributes:
        time: when (ns since 1970); tells it from all others.
        points: (N, 3) finite points of the cloud that the grasp was computed from.
        frame: name of the frame.
        sensor: (3,) where the camera was; None where unknown.
        gravity: (3,) unit vector that points down; None where unknown.
        region: the inside of the bin, or None.
        walls: the region's sides are walls.
        floor: the surface the objects lie on, where it was told.
        assume_empty: nothing is where nothing was seen.
        gripper: registered name.
        gripper_hash: of its description.
        world_from_tcp: (4, 4) TCP frame at the pre-grasp.
        world_from_gripper: (4, 4) gripper frame at the pre-grasp.
        approach: (4, 4) gripper frame at the stand-off.
        retreat: (4, 4) gripper frame where it went with the object.
        opening: between the fingers before they closed (m); NaN where undefined.
        width: between them at the contact, as expected (m); NaN where undefined.
        score: what was promised, 0..1.
        rank: place in the answer, 0 the best.
        model: id of the model.
        seed: of the synthesis.
        success: an object was taken.
        reason: why not, "" after a success.
        source: who tried it.
        extra: whatever else is worth keeping; JSON.
    """

    time: int
    points: FloatArray
    frame: str
    sensor: FloatArray | None
    gravity: FloatArray | None
    region: OrientedBox | None = None
    walls: bool = True
    floor: Plane | None = None
    assume_empty: bool = False
    gripper: str
    gripper_hash: str
    world_from_tcp: FloatArray
    world_from_gripper: FloatArray
    approach: FloatArray
    retreat: FloatArray
    opening: float = float("nan")
    width: float = float("nan")
    score: float
    rank: int = 0
    model: str
    seed: int
    success: bool
    reason: str = ""
    source: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)


class AttemptFolder:
    """Writes and reads the attempts in a folder; several processes may, at the same time.

    Args:
        folder: made by the first `add`.
        limit: bytes above which the oldest attempts are deleted; the newest one stays.

    Raises:
        InvalidRequestError: a limit below 1.
    """

    def __init__(self, folder: str | Path, limit: int = LIMIT) -> None:
        if limit < 1:
            raise InvalidRequestError(f"a limit of {limit} bytes was given; expected at least 1.")
        self.folder, self.limit = Path(folder), limit
        if self.folder.is_dir():
            remove_leftovers(self.folder, OLD)

    @property
    def paths(self) -> list[Path]:
        """The files, oldest first."""
        return sorted(self.folder.glob("attempt_*.npz"))

    def add(self, attempt: Attempt) -> Path:
        """Write an attempt, then delete the oldest ones over the limit.

        Raises:
            DataError: the attempt does not hold what it should.
            OSError: it could not be written.
        """
        wrong = problems(attempt)
        if wrong:
            raise DataError(f"an attempt has {'; '.join(wrong)}. It was not written.")
        while (path := self.folder / f"attempt_{attempt.time:020d}.npz").exists():
            attempt = replace(attempt, time=attempt.time + 1)
        write_npz(path, _arrays(attempt))
        self._drop_oldest()
        return path

    def read_all(self, notes: list[str]) -> Iterator[Attempt]:
        """Read the attempts, oldest first; a damaged one is left out and noted.

        Args:
            notes: gets a sentence for each that was left out.

        Raises:
            DataError: there is no such folder, or no attempt in it.
        """
        paths = self.paths
        if not paths:
            raise DataError(
                f"{self.folder} holds no attempt_*.npz; expected the folder that a cell recorded "
                "into (bin_clearing with record:=DIR, or GraspClient.record)."
            )
        for path in paths:
            try:
                yield read_attempt(path)
            except FileNotFoundError:
                # The cell at work has deleted it meanwhile.
                continue
            except (DamagedError, OSError) as error:
                notes.append(f"left out: {error}")
                log.warning("left out: %s", error)

    def _drop_oldest(self) -> None:
        sizes: dict[Path, int] = {}
        for path in self.paths:
            # Another process may be deleting, too.
            with suppress(FileNotFoundError):
                sizes[path] = path.stat().st_size
        total = sum(sizes.values())
        for path in list(sizes)[:-1]:
            if total <= self.limit:
                return
            path.unlink(missing_ok=True)
            total -= sizes[path]


def problems(attempt: Attempt) -> list[str]:
    """What is wrong with an attempt, in words."""
    wrong = []
    points = np.asarray(attempt.points)
    if points.ndim != 2 or points.shape[-1] != 3 or not len(points):
        wrong.append(f"points of shape {points.shape} (expected (N, 3), N > 0)")
    elif not np.isfinite(points).all():
        wrong.append("points that are not finite")
    for name in POSES:
        pose = np.asarray(getattr(attempt, name))
        rigid = pose.shape == (4, 4) and np.isfinite(pose).all()
        if not rigid or not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4):
            wrong.append(f"{name}, which is no rigid (4, 4) matrix")
    for name in ("sensor", "gravity"):
        vector = getattr(attempt, name)
        if vector is not None and (np.shape(vector) != (3,) or not np.isfinite(vector).all()):
            wrong.append(f"{name} {vector} (expected three finite numbers)")
    if not 0.0 <= attempt.score <= 1.0:
        wrong.append(f"score {attempt.score} (expected 0 to 1)")
    wrong += [f"no {name}" for name in ("gripper", "gripper_hash") if not getattr(attempt, name)]
    if attempt.time < 0 or attempt.seed < 0 or attempt.rank < 0:
        wrong.append(f"time {attempt.time}, seed {attempt.seed}, rank {attempt.rank} (below 0)")
    return wrong


def read_attempt(path: str | Path) -> Attempt:
    """The attempt in a file.

    Raises:
        DamagedError: it holds something else.
        OSError: it cannot be read.
    """
    path = Path(path)
    expected = "an attempt as a cell records it"
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}; expected an attempt_*.npz.")
    try:
        with open_npz(path) as file:
            attempt = _attempt(file)
    except DamagedError:
        raise
    except (KeyError, ValueError, TypeError, InvalidRequestError) as error:
        raise DamagedError.of(path, error, expected=expected) from error
    wrong = problems(attempt)
    if wrong:
        raise DamagedError.of(path, "; ".join(wrong), expected=expected)
    return attempt


PLAIN = (
    "time", "frame", "walls", "assume_empty", "gripper", "gripper_hash", "opening", "width",
    "score", "rank", "model", "seed", "success", "reason", "source",
)  # fmt: skip


def _arrays(attempt: Attempt) -> dict[str, np.ndarray]:
    plain = {name: getattr(attempt, name) for name in PLAIN}
    region, floor = attempt.region, attempt.floor
    meta = {
        "format": FORMAT,
        **{name: None if value != value else value for name, value in plain.items()},
        **{name: pose7_from_matrix(getattr(attempt, name)).tolist() for name in POSES},
        "sensor": _listed(attempt.sensor),
        "gravity": _listed(attempt.gravity),
        "region": region and [*pose7_from_matrix(region.world_from_box), *region.size.tolist()],
        "floor": floor and [*floor.normal.tolist(), float(floor.offset)],
        "extra": dict(attempt.extra),
    }
    points = np.asarray(attempt.points, dtype=np.float64)
    origin = np.round(np.median(points, axis=0), 3)
    # Axis by axis in whole steps: half of what floats take.
    steps = np.rint((points - origin).T / STEP).astype(np.int32)
    return {
        "meta": text_array(json.dumps(meta, allow_nan=False)),
        "points": np.ascontiguousarray(steps),
        "origin": origin,
    }


def _attempt(file: Mapping[str, np.ndarray]) -> Attempt:
    meta = json.loads(text_of(file["meta"]))
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise ValueError(f"format {FORMAT} is what this version reads")
    wrong = [name for name in PLAIN if not isinstance(meta[name], _KINDS[name])]
    if wrong:
        raise ValueError(f"{', '.join(wrong)} of another type")
    plain = {name: float("nan") if meta[name] is None else meta[name] for name in PLAIN}
    poses = {name: np.asarray(matrix_from_pose7(_numbers(meta, name, 7))) for name in POSES}
    optional = {name: _numbers(meta, name, 3) for name in ("sensor", "gravity")}
    region, floor = _numbers(meta, "region", 10), _numbers(meta, "floor", 4)
    return Attempt(
        **plain,
        **poses,
        **optional,
        points=file["points"].T * STEP + file["origin"],
        region=None
        if region is None
        else OrientedBox(np.asarray(matrix_from_pose7(region[:7])), region[7:]),
        floor=None if floor is None else Plane(floor[:3], float(floor[3])),
        extra=meta["extra"],
    )


_KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(PLAIN, str),
    **dict.fromkeys(("time", "rank", "seed"), int),
    **dict.fromkeys(("walls", "assume_empty", "success"), bool),
    **dict.fromkeys(("opening", "width"), (float, int, type(None))),
    "score": (float, int),
}


def _numbers(meta: Mapping[str, Any], name: str, count: int) -> Any:
    """(count,) float64, or None where there are none."""
    if meta[name] is None:
        return None
    numbers = np.asarray(meta[name], dtype=np.float64)
    if numbers.shape != (count,):
        raise ValueError(f"{name} has {numbers.size} numbers, not {count}")
    return numbers


def _listed(vector: FloatArray | None) -> list[float] | None:
    return None if vector is None else np.asarray(vector, dtype=np.float64).tolist()

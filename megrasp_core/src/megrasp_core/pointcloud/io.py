"""Point cloud files: PLY, PCD, NPZ, NPY. What cannot be read whole is an error, never points."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError

from .arrays import read_npy, read_npz
from .cloud import Cloud
from .pcd import read_pcd, write_pcd
from .ply import read_ply, write_ply

LOGGER = logging.getLogger(__name__)
READERS: dict[str, Callable[[Path], Cloud]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": read_npz,
    ".npy": read_npy,
}
SUFFIXES = tuple(READERS)
FARTHEST, NEAREST = 1e7, 1e-6
"""No coordinates (m) of a scene are all below the one, or beyond the other."""


def read_cloud(path: str | Path, *, optical: bool = False) -> Cloud:
    """Read a cloud in metres; rows with NaN or infinity are dropped, and those that are exactly
    0 0 0 or at the sensor, as many drivers mark pixels without a reading.

    .ply, .pcd: points and colours; .pcd: the sensor's place. .npz: array `points` (N, 3) or
    (H, W, 3), optional `colors` (0..1, or 0..255 as integers), `viewpoint` (3,) or one row a
    point, and `labels` (N,) of objects; or `depth` (H, W) with `K` (3, 3). .npy: the points alone.

    Args:
        path: of the file.
        optical: the sensor's axes are wanted; otherwise points of a .pcd that are in them are
            moved into the frame of its VIEWPOINT.

    Raises:
        CloudError: a missing file, another suffix, a damaged file, a wrong shape, or no point.
    """
    path = Path(path)
    suffix = _known_suffix(path)
    if not path.is_file():
        raise CloudError(
            f"no cloud file {path}: it does not exist or is a folder. Expected a file with one "
            f"of {_suffixes()}."
        )
    try:
        cloud = read_pcd(path, optical=optical) if suffix == ".pcd" else READERS[suffix](path)
    except OSError as error:
        raise CloudError(f"{path} cannot be read ({error}).") from error
    if not len(cloud):
        raise CloudError(f"{path} holds no points; expected at least one. Was the scene captured?")
    finite = cloud.finite()
    if not len(finite):
        raise CloudError(
            f"all {len(cloud)} points of {path} are NaN or infinite; expected metres. Check the "
            "depth image."
        )
    farthest = float(np.abs(finite.points).max())
    if farthest > FARTHEST or 0.0 < farthest < NEAREST:
        raise CloudError(
            f"{path} has coordinates up to {farthest:.3g}; expected metres. The file is damaged, "
            "or its numbers are of another type or byte order than it says."
        )
    seen = without_zeros(finite)
    if len(seen) < len(finite):
        LOGGER.warning(
            "%d of %d points of %s are exactly 0 0 0 or where the sensor is, which are pixels "
            "without a reading; they are left out",
            len(finite) - len(seen),
            len(cloud),
            path,
        )
    if not len(seen):
        raise CloudError(f"all {len(finite)} points of {path} are 0 0 0; expected metres.")
    if len(seen) > 1 and (seen.points == seen.points[0]).all():
        raise CloudError(
            f"all {len(seen)} points of {path} are {seen.points[0].tolist()}; expected a surface."
        )
    return seen


def without_zeros(cloud: Cloud) -> Cloud:
    """The cloud without points that are exactly 0 0 0 or at the sensor, where there are several: a
    surface has no two points in one place, pixels without a reading do, also once transformed.
    """
    empty = _several((cloud.points == 0.0).all(axis=1))
    if cloud.viewpoint is not None:
        # Transformed in 32 bits, they are where the sensor is but for the last bit.
        near = np.isclose(cloud.points, cloud.viewpoint, rtol=1e-6, atol=1e-6)
        empty |= _several(np.asarray(near.all(axis=1)))
    return cloud.select(~empty) if empty.any() else cloud


def _several(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return mask if np.count_nonzero(mask) > 1 else np.zeros_like(mask)


def write_cloud(path: str | Path, cloud: Cloud, *, binary: bool = True) -> None:
    """Write a cloud; the suffix decides the format, `binary=False` writes PLY and PCD as text.

    Only .npz keeps everything. Of the rest .pcd keeps the viewpoint where it is one place for all
    points, .ply none; neither keeps labels; .npy keeps the points alone. Missing folders are made.

    Args:
        path: of the file.
        cloud: to write; no coordinate changes by more than 0.1 mm.
        binary: for .ply and .pcd.

    Raises:
        CloudError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    suffix = _known_suffix(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".npy":
            np.save(path, cloud.points)
        elif suffix == ".npz":
            extra = {
                "colors": cloud.colors,
                "viewpoint": cloud.viewpoint,
                "labels": cloud.labels,
            }
            arrays: dict[str, Any] = {
                key: value for key, value in extra.items() if value is not None
            }
            np.savez_compressed(path, points=cloud.points, **arrays)
        elif suffix == ".ply":
            write_ply(path, cloud, binary=binary)
        else:
            write_pcd(path, cloud, binary=binary)
    except OSError as error:
        raise CloudError(
            f"cannot write {path} ({error}); expected a folder that may be written to."
        ) from error


def _suffixes() -> str:
    return ", ".join(SUFFIXES)


def _known_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise CloudError(
            f"{path} has the suffix {suffix or '(none)'!r}; expected one of {_suffixes()}. "
            "Convert the cloud."
        )
    return suffix

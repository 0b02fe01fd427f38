"""Point cloud files: PLY, PCD, NPZ, NPY."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError

from .cloud import Cloud

# What numpy raises for files that are cut short or are something else.
_DAMAGE = (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error)
SUFFIXES = (".ply", ".pcd", ".npz", ".npy")


def read_cloud(path: str | Path) -> Cloud:
    """Read a cloud in metres; rows with NaN or infinity are dropped.

    .ply, .pcd: points and colours. .npz: array `points` (N, 3) or (H, W, 3), optional `colors`
    (0..1, or 0..255 as integers) and `viewpoint` (3,) or one row a point. .npy: the points alone.

    Raises CloudError for a missing file, another suffix, a damaged file, a wrong shape, and when
    no finite point is in it.
    """
    path = Path(path)
    suffix = _known_suffix(path)
    if not path.is_file():
        raise CloudError(
            f"no cloud file {path}: it does not exist or is a folder. Expected a file with one "
            f"of {_suffixes()}."
        )
    if suffix == ".npz":
        cloud = _read_npz(path)
    elif suffix == ".npy":
        cloud = _build(path, _load(path), None, None)
    else:
        cloud = _read_open3d(path)
    if not len(cloud):
        raise CloudError(f"{path} holds no points; expected at least one. Was the scene captured?")
    finite = cloud.finite()
    if not len(finite):
        raise CloudError(
            f"all {len(cloud)} points of {path} are NaN or infinite; expected metres. Check the "
            "depth image."
        )
    return finite


def write_cloud(path: str | Path, cloud: Cloud, *, binary: bool = True) -> None:
    """Write a cloud; the suffix decides the format, `binary=False` writes PLY and PCD as text.

    Only .npz keeps the viewpoint; .npy keeps the points alone. Missing folders are made.
    Raises CloudError for another suffix or when the file cannot be written.
    """
    path = Path(path)
    suffix = _known_suffix(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".npy":
            np.save(path, cloud.points)
        elif suffix == ".npz":
            extra = {"colors": cloud.colors, "viewpoint": cloud.viewpoint}
            arrays: dict[str, Any] = {
                key: value for key, value in extra.items() if value is not None
            }
            np.savez_compressed(path, points=cloud.points, **arrays)
        else:
            _write_open3d(path, cloud, binary)
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


def _load(path: Path) -> Any:
    try:
        # No pickles: a cloud from elsewhere must not run code.
        return np.load(path, allow_pickle=False)
    except _DAMAGE as error:
        raise CloudError(
            f"{path} is damaged or no numpy file ({error}); expected float arrays."
        ) from error


def _read_npz(path: Path) -> Cloud:
    archive = _load(path)
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise CloudError(f"{path} is no .npz archive; expected one with an array 'points' (N, 3).")
    with archive:
        if "points" not in archive:
            names = ", ".join(sorted(archive.files)) or "(none)"
            raise CloudError(
                f"{path} has the arrays {names}; expected one named 'points' of shape (N, 3)."
            )
        try:
            arrays = {
                key: archive[key] for key in ("points", "colors", "viewpoint") if key in archive
            }
        except _DAMAGE as error:
            raise CloudError(f"{path} is damaged ({error}); expected float arrays.") from error
    return _build(path, arrays["points"], arrays.get("colors"), arrays.get("viewpoint"))


def _build(
    path: Path, points: NDArray[Any], colors: NDArray[Any] | None, viewpoint: NDArray[Any] | None
) -> Cloud:
    """Make the cloud; (H, W, 3) is flattened, integer colours are brought to 0..1."""
    if colors is not None:
        scale = 255.0 if np.issubdtype(colors.dtype, np.integer) else 1.0
        colors = _flat(colors)[..., :3] / scale
    if viewpoint is not None:
        viewpoint = _flat(viewpoint)
    try:
        return Cloud(_flat(points), colors, viewpoint)
    except CloudError as error:
        raise CloudError(f"{path}: {error}") from None


def _flat(array: NDArray[Any]) -> NDArray[Any]:
    return array.reshape(-1, array.shape[-1]) if array.ndim == 3 else array


def _read_open3d(path: Path) -> Cloud:
    # Imported here: it takes a second or more, and most callers read no PLY or PCD.
    import open3d as o3d

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        data = o3d.io.read_point_cloud(path)
    points = np.asarray(data.points)
    if not len(points):
        raise CloudError(
            f"{path} holds no points or is no {path.suffix.lower()} file; expected a point cloud "
            "in metres with the fields x, y, z."
        )
    return Cloud(points.copy(), np.asarray(data.colors).copy() if data.has_colors() else None)


def _write_open3d(path: Path, cloud: Cloud, binary: bool) -> None:
    import open3d as o3d

    data = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
    if cloud.colors is not None:
        data.colors = o3d.utility.Vector3dVector(cloud.colors)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        written = o3d.io.write_point_cloud(path, data, write_ascii=not binary)
    if not written:
        raise CloudError(f"cannot write {path}; expected a folder that may be written to.")

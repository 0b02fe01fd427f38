"""NPY and NPZ files: arrays of points, named exactly where they are something else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError

from .cloud import Cloud
from .colours import as_shares
from .depth_points import depth_points

SMALLEST_IMAGE = 16
"""Arrays of at least so many rows and columns look like an image, not like points."""
KINDS = "fiu"


def read_npy(path: Path) -> Cloud:
    """An array of points (N, 3), (H, W, 3), or a structured one with the fields x, y, z.

    Raises:
        CloudError: it is damaged, or another array; the message says which and what to do.
    """
    array = _load(path)
    if not isinstance(array, np.ndarray):
        raise CloudError(f"{path} is an archive of arrays; expected one array. Name it .npz.")
    points, colors = _points(path, "it", array)
    return _cloud(path, points, colors, None)


def read_npz(path: Path) -> Cloud:
    """`points` as `read_npy` takes them, optional `colors`, `viewpoint` and `labels`; or an image
    `depth` (H, W) in metres along the optical axis with its camera matrix `K` (3, 3).

    Raises:
        CloudError: it is damaged, or holds neither.
    """
    archive = _load(path)
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise CloudError(f"{path} is no .npz archive; expected one with an array 'points' (N, 3).")
    wanted = ("points", "colors", "viewpoint", "labels", "depth", "K")
    with archive:
        names = ", ".join(sorted(archive.files)) or "(none)"
        try:
            arrays = {name: archive[name] for name in wanted if name in archive.files}
        # As below.
        except Exception as error:
            if "allow_pickle" in str(error):
                raise _pickled(path) from None
            raise CloudError(f"{path} is damaged ({error}); expected float arrays.") from error
    if "points" in arrays:
        points, colors = _points(path, "'points'", arrays["points"])
        if "colors" in arrays:
            colors = _colours(path, arrays["colors"])
        return _cloud(path, points, colors, arrays.get("viewpoint"), arrays.get("labels"))
    if {"depth", "K"} <= set(arrays):
        points = _of_depth(path, arrays["depth"], arrays["K"])
        return Cloud(points, None, np.zeros(3))
    raise CloudError(
        f"{path} has the arrays {names}; expected one named 'points' of shape (N, 3), or 'depth' "
        "(H, W) in metres with the camera matrix 'K' (3, 3)."
    )


def _load(path: Path) -> Any:
    try:
        # No pickles: a cloud from elsewhere must not run code.
        return np.load(path, allow_pickle=False)
    # A damaged header goes through numpy's tokenizer, which raises what it likes.
    except Exception as error:
        if "allow_pickle" in str(error):
            raise _pickled(path) from None
        raise CloudError(
            f"{path} is damaged or no numpy file ({error}); expected float arrays."
        ) from error


def _pickled(path: Path) -> CloudError:
    return CloudError(
        f"{path} holds a pickled Python object, which is not read for safety; expected plain "
        "arrays. Save them with np.savez(path, points=points), and leave out what is None."
    )


def _points(path: Path, what: str, array: NDArray) -> tuple[NDArray, NDArray | None]:
    """Points (N, 3) of an array, and colours where it has them."""
    names = array.dtype.names
    if names is not None:
        if not {"x", "y", "z"} <= set(names):
            raise CloudError(
                f"{path}: {what} has the fields {', '.join(names)}; expected x, y, z."
            )
        return np.stack([array[name].ravel() for name in "xyz"], axis=1), None
    if array.dtype.kind not in KINDS:
        raise CloudError(f"{path}: {what} is of type {array.dtype}; expected numbers in metres.")
    shape = array.shape
    if array.ndim == 3 and shape[-1] == 3:
        return array.reshape(-1, 3), None
    if array.ndim == 2 and shape[1] == 3:
        return array, None
    raise CloudError(f"{path}: {what} has the shape {shape}; expected (N, 3). {_advice(shape)}")


def _advice(shape: tuple[int, ...]) -> str:
    if len(shape) == 2 and min(shape) >= SMALLEST_IMAGE:
        return (
            "It looks like a depth image: give it as --depth with --intrinsics FX FY CX CY, or "
            "save it as 'depth' in metres with the camera matrix 'K' in one .npz."
        )
    if len(shape) == 2 and shape[0] == 3:
        return "Transpose it: points.T."
    if len(shape) == 2 and 3 < shape[0] < SMALLEST_IMAGE <= shape[1]:
        return "It lies on its side. If x, y, z come first, take rows 0 to 2: points[:3].T."
    if len(shape) == 3 and shape[0] == 3:
        return "The axes are in another order: np.moveaxis(points, 0, -1)."
    if len(shape) == 2 and shape[1] > 3:
        return "If x, y, z come first, take columns 0 to 2: points[:, :3]."
    if len(shape) == 3 and shape[-1] > 3:
        return "If x, y, z come first, take points[..., :3]."
    return "One row of x, y, z in metres for each point."


def _colours(path: Path, colors: NDArray) -> NDArray[np.float64]:
    if colors.ndim not in (2, 3) or colors.shape[-1] < 3 or colors.dtype.kind not in KINDS:
        raise CloudError(
            f"{path}: 'colors' is {colors.dtype} of shape {colors.shape}; expected (N, 3): red, "
            "green, blue of each point. Give them so, or leave them out."
        )
    flat = colors.reshape(-1, colors.shape[-1]) if colors.ndim == 3 else colors
    return as_shares(flat[..., :3], np.dtype("u1") if flat.dtype.kind in "iu" else flat.dtype)


def _cloud(
    path: Path,
    points: NDArray,
    colors: NDArray | None,
    viewpoint: NDArray | None,
    labels: NDArray | None = None,
) -> Cloud:
    if viewpoint is not None and viewpoint.ndim == 3:
        viewpoint = viewpoint.reshape(-1, viewpoint.shape[-1])
    try:
        return Cloud(points, colors, viewpoint, None if labels is None else labels.ravel())
    except CloudError as error:
        raise CloudError(f"{path}: {error}") from None


def _of_depth(path: Path, depth: NDArray, matrix: NDArray) -> NDArray[np.float64]:
    if depth.dtype.kind != "f":
        raise CloudError(
            f"{path}: 'depth' is {depth.dtype}; expected floats in metres. Divide whole "
            "millimetres by 1000, or give the file as --depth."
        )
    try:
        return depth_points(depth, matrix)
    except CloudError as error:
        raise CloudError(f"{path}: {error}") from None

"""Points of a depth image, and depth images, colours and labels from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, UnidentifiedImageError

from megrasp_core.errors import CloudError

from .cloud import Cloud

OBLONG = 1.5
"""No pixel is longer than wide, or wider than long, by this."""
SMALLEST_PICTURE = 64
"""Images of fewer columns do not come from a camera as they are."""
FARTHEST = 1e3
"""A depth beyond it (m) is no reading."""
MILLIMETRES = 0.001
IMAGES = (".png", ".tif", ".tiff")
ARRAYS = (".npy", ".npz")


def depth_points(depth: ArrayLike, matrix: ArrayLike) -> NDArray[np.float64]:
    """Points (H * W, 3) in the camera's frame: x right, y down, z forward; NaN without a depth.

    Args:
        depth: (H, W) along the optical axis (m); 0, negative and not finite: no reading.
        matrix: (3, 3) camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] (pixels).

    Raises:
        CloudError: a shape is wrong, or the matrix is not that of a camera with such an image.
    """
    z = np.array(depth, dtype=np.float64)
    k = np.asarray(matrix, dtype=np.float64)
    if z.ndim != 2 or k.shape != (3, 3):
        raise CloudError(
            f"the depth image has the shape {z.shape} and the camera matrix {k.shape}; expected "
            "(H, W) and (3, 3)."
        )
    if not np.isfinite(k).all() or k[0, 0] <= 0 or k[1, 1] <= 0:
        raise CloudError(
            f"the camera matrix is {k.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] "
            "with focal lengths over 0, in pixels."
        )
    _check_matrix(k, z.shape)
    z[~((z > 0) & (z < FARTHEST))] = np.nan
    v, u = np.indices(z.shape)
    x, y = (u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _check_matrix(k: NDArray[np.float64], shape: tuple[int, ...]) -> None:
    height, width = shape
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    if k[1, 0] != 0.0 or abs(k[0, 1]) > 0.01 * fx or (k[2] != [0.0, 0.0, 1.0]).any():
        raise CloudError(
            f"the camera matrix is {k.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. "
            "It may be transposed."
        )
    if width < SMALLEST_PICTURE:
        return
    if not 1 / OBLONG < fx / fy < OBLONG:
        raise CloudError(
            f"the focal lengths are fx {fx:g} and fy {fy:g}; expected nearly the same (square "
            "pixels). The order is fx fy cx cy."
        )
    if not (0.0 <= cx <= width - 1 and 0.0 <= cy <= height - 1):
        raise CloudError(
            f"the principal point cx {cx:g}, cy {cy:g} lies outside the image of {width} x "
            f"{height} pixels; expected it near the middle. Are the intrinsics of another "
            "resolution? Scale all four by the same factor. The order is fx fy cx cy. A part cut "
            "from an image is filled up with zeros to the whole."
        )
    off = np.array([2.0 * cx / width, 2.0 * cy / height])
    if off.max() < 0.8 and abs(off[0] - off[1]) < 0.05:
        raise CloudError(
            f"the principal point is cx {cx:g}, cy {cy:g} in an image of {width} x {height} "
            "pixels; expected it near the middle. The intrinsics seem to be of an image of about "
            f"{off.mean() * width:.0f} x {off.mean() * height:.0f}: scale all four by "
            f"{1 / off.mean():.3g}."
        )


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> NDArray[np.float64]:
    """(3, 3) camera matrix of focal lengths and principal point (pixels)."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def depth_cloud(
    depth: ArrayLike,
    matrix: ArrayLike,
    *,
    scale: float | None = None,
    colors: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    what: str = "the depth image",
) -> Cloud:
    """A cloud in the camera's frame, whose origin is the viewpoint; pixels without a reading are
    left out.

    Args:
        depth: (H, W) whole numbers or floats; 0, negative and not finite: no reading.
        matrix: (3, 3) camera matrix (pixels).
        scale: metres per unit; None: 0.001 for whole numbers, 1 for floats. The largest whole
            number of the type is no reading either.
        colors: (H * W, 3) in 0..1.
        labels: (H, W) whole numbers: which object a pixel belongs to; 0: none.
        what: names the image in messages.

    Raises:
        CloudError: a shape or number does not fit; no pixel has a reading.
    """
    image = np.asarray(depth)
    factor = scale if scale is not None else (1.0 if image.dtype.kind == "f" else MILLIMETRES)
    if not (np.isfinite(factor) and factor > 0):
        raise CloudError(f"the depth scale is {factor}; expected metres per unit, over 0.")
    depths = factor * image.astype(np.float64)
    if image.dtype.kind in "iu":
        # Some cameras write the largest number where there is no reading.
        depths[image == np.iinfo(image.dtype).max] = np.nan
    points = depth_points(depths, matrix)
    of = None
    if labels is not None:
        of = np.asarray(labels)
        if of.dtype.kind == "f" or of.shape != image.shape:
            raise CloudError(
                f"the mask is {of.dtype} of {_size(of)} pixels; expected whole numbers, "
                f"{_size(image)} as {what}: one number for each object, 0 elsewhere."
            )
        of = of.ravel()
    coloured = None if colors is None else np.asarray(colors, dtype=np.float64)
    seen = Cloud(points, coloured, np.zeros(3), of).finite()
    if not len(seen):
        raise CloudError(
            f"none of the {image.size} pixels of {what} has a reading; expected depths over 0 and "
            f"under {FARTHEST:g} m, at {factor:g} m per unit (--depth-scale)."
        )
    return seen


def read_depth_cloud(
    depth: str | Path,
    matrix: ArrayLike | None = None,
    *,
    scale: float | None = None,
    color: str | Path | None = None,
    mask: str | Path | None = None,
) -> Cloud:
    """A cloud in the camera's frame, whose origin is the viewpoint; pixels without a reading are
    left out.

    Args:
        depth: .png or .tif of 16 bits or floats, .npy (H, W), or .npz with `depth` and, where no
            matrix is given, `K`.
        matrix: (3, 3) camera matrix; None: the file's `K`.
        scale: metres per unit; None: 0.001 for whole numbers, 1 for floats.
        color: image of the same size.
        mask: which object a pixel belongs to: .png, .tif of whole numbers, or .npy; 0: none.

    Raises:
        CloudError: a file is missing, damaged or of another kind or size; no pixel has a reading.
    """
    depth = Path(depth)
    image, stated = _numbers(depth, "depth")
    if matrix is None:
        matrix = stated
    if matrix is None:
        raise CloudError(
            f"{depth} comes without a camera matrix; expected the intrinsics fx fy cx cy in "
            "pixels (--intrinsics), or an .npz with 'depth' and 'K'."
        )
    if image.dtype == np.uint8:
        raise CloudError(
            f"{depth} has 8 bits a pixel; expected a depth image of 16 bits or floats. It looks "
            "like a picture of one: save the depth itself."
        )
    colors = None if color is None else _color(Path(color), image.shape)
    labels = None if mask is None else _numbers(Path(mask), "mask")[0]
    return depth_cloud(image, matrix, scale=scale, colors=colors, labels=labels, what=str(depth))


def _numbers(path: Path, name: str) -> tuple[NDArray, NDArray | None]:
    """(H, W) of a file, and its camera matrix where it has one."""
    suffix = path.suffix.lower()
    if suffix not in IMAGES + ARRAYS:
        raise CloudError(
            f"{path} has the suffix {suffix or '(none)'!r}; expected one of "
            f"{', '.join(IMAGES + ARRAYS)}."
        )
    if not path.is_file():
        raise CloudError(f"no file {path}: it does not exist or is a folder.")
    matrix = None
    try:
        if suffix in IMAGES:
            with Image.open(path) as opened:
                array = np.array(opened)
        else:
            # No pickles: a file from elsewhere must not run code.
            loaded = np.load(path, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                array = loaded
            else:
                with loaded:
                    if name not in loaded.files:
                        names = ", ".join(loaded.files) or "(none)"
                        raise CloudError(f"{path} has the arrays {names}; expected {name!r}.")
                    array = loaded[name]
                    matrix = loaded["K"] if "K" in loaded.files else None
    except CloudError:
        raise
    # Damaged files raise what numpy, zlib or Pillow like.
    except (UnidentifiedImageError, Exception) as error:
        raise CloudError(f"{path} is damaged or no {suffix} file ({error}).") from error
    if array.ndim == 3 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim != 2 or array.dtype.kind not in "fiub":
        raise CloudError(
            f"{path} has the shape {array.shape} of {array.dtype}; expected one number for each "
            "pixel, (H, W)."
        )
    return array, matrix


def _color(path: Path, size: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        with Image.open(path) as opened:
            picture = np.asarray(opened.convert("RGB"), dtype=np.float64) / 255.0
    except (OSError, ValueError) as error:
        raise CloudError(f"{path} cannot be read as a picture ({error}).") from error
    if picture.shape[:2] != size:
        raise CloudError(
            f"{path} has {picture.shape[1]} x {picture.shape[0]} pixels; expected those of the "
            f"depth image, {size[1]} x {size[0]}. Register the colours to the depth."
        )
    return picture.reshape(-1, 3)


def _size(image: NDArray) -> str:
    return " x ".join(map(str, image.shape[::-1]))

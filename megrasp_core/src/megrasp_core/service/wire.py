"""What goes over the wire: a cloud file as body, options as JSON, answers as JSON."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import CloudError, InvalidRequestError
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.pointcloud import Cloud, OrientedBox, Plane, read_cloud
from megrasp_core.ranges import ANY
from megrasp_core.synthesizer import SynthesisRequest

__all__ = ["cloud_of", "options_in", "request_of"]

MAGIC = {b"PK\x03\x04": ".npz", b"\x93NUM": ".npy", b"ply\n": ".ply", b"ply\r": ".ply"}
"""First bytes of a body, and the kind of file that it is; PCD files begin with a comment."""


def cloud_of(body: bytes) -> Cloud:
    """The cloud in a body: the content of a .npz, .npy, .ply or .pcd file (metres).

    Raises:
        CloudError: it is none of them, or damaged.
    """
    suffix = MAGIC.get(body[:4])
    if suffix is None and b"VERSION" in body[:200] and b"FIELDS" in body[:400]:
        suffix = ".pcd"
    if suffix is None:
        raise CloudError(
            f"the body of {len(body)} bytes is no cloud; expected the content of a .npz, .npy, "
            ".ply or .pcd file, in metres."
        )
    with tempfile.TemporaryDirectory(prefix="megrasp-") as folder:
        path = Path(folder) / f"cloud{suffix}"
        path.write_bytes(body)
        try:
            return read_cloud(path)
        except CloudError as error:
            raise CloudError(str(error).replace(str(path), "the body")) from None


def options_in(body: bytes) -> bytes:
    """The options in a body: the array `request` of a .npz, UTF-8 bytes of JSON (uint8) or a text.

    Raises:
        InvalidRequestError: there is none.
    """
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            array = archive["request"]
        return array.tobytes() if array.dtype == np.uint8 else str(array.item()).encode()
    # A damaged archive raises what numpy and zipfile like.
    except Exception as error:
        raise InvalidRequestError(
            f"the request was said to be in the body, which has none ({error}); expected a .npz "
            "with an array 'request', JSON as UTF-8 bytes."
        ) from None


def request_of(options: dict[str, Any]) -> SynthesisRequest:
    """A request of JSON options: those of `SynthesisRequest` by name.

    `region` is {"pose": [x, y, z, qx, qy, qz, qw], "size": [x, y, z]}, `floor` a height or
    [nx, ny, nz, d], `exclude` a list of poses of 7 numbers.

    Raises:
        InvalidRequestError, GravityError: an option is unknown or wrong.
    """
    given = dict(options)
    try:
        if isinstance(given.get("region"), dict):
            region = given["region"]
            pose = matrix_from_pose7(_numbers(region["pose"]))
            given["region"] = OrientedBox(pose, np.array(_numbers(region["size"]), np.float64))
        if isinstance(given.get("floor"), list):
            given["floor"] = Plane.of(_numbers(given["floor"]))
        if isinstance(given.get("exclude"), list):
            given["exclude"] = [matrix_from_pose7(_numbers(pose)) for pose in given["exclude"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"region, floor or exclude are not as expected ({error!r}); expected region "
            '{"pose": [7 numbers], "size": [3 numbers]}, floor a height or [nx, ny, nz, d], '
            "exclude a list of poses of 7 numbers."
        ) from None
    return SynthesisRequest.of(**given)


def _numbers(values: list[Any]) -> list[Any]:
    """These, where all of them are numbers."""
    if not isinstance(values, list) or not all(map(ANY.takes, values)):
        raise ValueError(f"{str(values)[:100]} is no list of numbers")
    return values

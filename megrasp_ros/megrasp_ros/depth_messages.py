"""Clouds from depth images with their camera_info and, where there is one, a mask of objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

from megrasp_core.errors import CloudError

from .conversions import whole_labels
from .errors import shortened

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud

DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""Encodings of depth images: whole numbers are millimetres, floats metres."""

MASKS = {
    "8UC1": "u1", "mono8": "u1", "8SC1": "i1", "16UC1": "u2", "mono16": "u2", "16SC1": "i2",
    "32SC1": "i4", "32UC1": "u4",
}  # fmt: skip
"""Encodings of masks."""

FISHEYES = ("equidistant", "fisheye", "kannala_brandt4")
"""Models of lenses that bend lines even with all coefficients 0."""


def cloud_from_depth(depth: Image, info: CameraInfo, mask: Image | None) -> Cloud:
    """Return the points of a depth image in the frame of its camera, which looks along +z from
    the origin; pixels without a reading are left out.

    Raises CloudError when an encoding is unknown, the messages do not fit together, the image is
    distorted, or no pixel has a reading.
    """
    from megrasp_core.pointcloud import depth_cloud

    image = _pixels(depth, DEPTHS, "depth image")
    _check_camera(depth, info)
    labels = None
    if mask is not None:
        _check_same(depth, mask.height, mask.width, mask.header.frame_id, "mask")
        labels = whole_labels(_pixels(mask, MASKS, "mask"))
    return depth_cloud(image, np.reshape(info.k, (3, 3)), labels=labels)


def _pixels(image: Image, types: dict[str, str], what: str) -> NDArray:
    """Return (height, width) numbers of an image of one channel."""
    if image.encoding not in types:
        raise CloudError(
            f"the {what} has the encoding {shortened(image.encoding, 40)!r}; expected one of "
            f"{', '.join(types)}. Publish it as one channel of numbers, not as a picture."
        )
    kind = np.dtype((">" if image.is_bigendian else "<") + types[image.encoding])
    row = image.width * kind.itemsize
    if not image.width or not image.height:
        raise CloudError(
            f"the {what} is empty (width {image.width}, height {image.height}). Check the camera."
        )
    # As for clouds: a single row needs no step.
    step = image.step if image.height > 1 else row
    needed = (image.height - 1) * step + row
    if step < row or len(image.data) < needed:
        raise CloudError(
            f"the {what} has {len(image.data)} bytes in rows of {image.step}; expected "
            f"{image.width} x {image.height} pixels of {kind.itemsize} bytes. The message was cut "
            "or filled wrongly."
        )
    return np.ndarray(
        (image.height, image.width), kind, memoryview(image.data), strides=(step, kind.itemsize)
    )


def _check_camera(depth: Image, info: CameraInfo) -> None:
    _check_same(depth, info.height, info.width, info.header.frame_id, "camera_info")
    model = shortened(info.distortion_model, 40)
    if any(info.d) or info.distortion_model in FISHEYES:
        raise CloudError(
            f"camera_info says that the image is distorted ({model!r}, "
            f"{len(info.d)} coefficients, not all 0); expected a rectified depth image. Rectify "
            "it (image_proc), with a camera_info whose d is 0, or publish a cloud."
        )
    roi = info.roi
    if max(info.binning_x, info.binning_y) > 1 or roi.x_offset or roi.y_offset:
        raise CloudError(
            f"camera_info has a binning of {info.binning_x} x {info.binning_y} and a region at "
            f"{roi.x_offset}, {roi.y_offset}; expected that k is of the image as it is. Publish "
            "the whole image, or a camera_info without binning and region."
        )


def _check_same(depth: Image, height: int, width: int, frame: str, what: str) -> None:
    if (height, width) != (depth.height, depth.width):
        raise CloudError(
            f"the {what} is of {width} x {height} pixels and the depth image has {depth.width} x "
            f"{depth.height}; expected the same. Take those of one camera; depth that is aligned "
            "to colour goes with the camera_info of the colour."
        )
    if frame and frame != depth.header.frame_id:
        raise CloudError(
            f"the {what} is of the frame {shortened(frame, 80)!r} and the depth image of "
            f"{shortened(depth.header.frame_id, 80)!r}; expected the same. Take those of one "
            "camera; depth that is aligned to colour goes with the camera_info of the colour."
        )

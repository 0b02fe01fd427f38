"""Depth images, camera_info and masks become clouds, or errors that say what does not fit."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from depth_client import FRAME, HEIGHT, HIGH, LOW, WIDTH, K, image, info, scene
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Header

from megrasp_core.errors import CloudError
from megrasp_core.pointcloud import depth_points
from megrasp_ros.depth_messages import cloud_from_depth

STAMP = Time(sec=1)
DEPTH, MASK = scene()
EXPECTED = depth_points(DEPTH, np.reshape(K, (3, 3)))
SEEN = np.isfinite(EXPECTED).all(axis=1)


def depth_image(kind: str = "<u2", **fields: Any):
    numbers = (1000 * DEPTH).round() if "u2" in kind else np.where(DEPTH > 0, DEPTH, np.nan)
    encoding = "16UC1" if "u2" in kind else "32FC1"
    return image(numbers.astype(kind), **{"encoding": encoding, "stamp": STAMP, **fields})


@pytest.mark.parametrize("kind", ["<u2", ">u2", "<f4", ">f4"])
def test_pixels_become_points_and_those_without_a_reading_none(kind: str) -> None:
    cloud = cloud_from_depth(
        depth_image(kind, is_bigendian=int(kind[0] == ">")), info(STAMP), None
    )
    np.testing.assert_allclose(cloud.points, EXPECTED[SEEN], atol=1e-6)
    assert cloud.labels is None
    np.testing.assert_array_equal(cloud.viewpoint, np.zeros(3))


def test_rows_may_be_padded() -> None:
    wide = np.zeros((HEIGHT, WIDTH + 3), "<u2")
    wide[:, :WIDTH] = (1000 * DEPTH).round()
    cloud = cloud_from_depth(image(wide, "16UC1", STAMP, width=WIDTH), info(STAMP), None)
    np.testing.assert_allclose(cloud.points, EXPECTED[SEEN], atol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [("mono8", "u1"), ("8UC1", "u1"), ("mono16", "<u2"), ("16UC1", "<u2"), ("32SC1", "<i4")],
)
def test_a_mask_labels_the_points(encoding: str, kind: str) -> None:
    cloud = cloud_from_depth(depth_image(), info(STAMP), image(MASK.astype(kind), encoding, STAMP))
    assert cloud.labels is not None
    np.testing.assert_array_equal(cloud.labels, MASK.ravel()[SEEN])
    assert set(np.unique(cloud.labels)) == {0, LOW, HIGH}


def test_negative_labels_are_none() -> None:
    mask = np.where(MASK == LOW, -1, MASK.astype("<i4")).astype("<i4")
    labels = cloud_from_depth(depth_image(), info(STAMP), image(mask, "32SC1", STAMP)).labels
    assert labels is not None and set(np.unique(labels)) == {0, HIGH}


@pytest.mark.parametrize(
    ("depth", "camera", "words"),
    [
        ({"encoding": "rgb8"}, {}, ["'rgb8'", "16UC1", "32FC1"]),
        ({"data": array("B", bytes(10))}, {}, ["10 bytes", "cut or filled wrongly"]),
        ({"step": 3}, {}, ["rows of 3"]),
        ({"width": 0}, {}, ["empty"]),
        ({"width": 2**32 - 1, "height": 2**32 - 1}, {}, ["cut or filled wrongly"]),
        ({}, {"d": [0.1, 0.0, 0.0, 0.0, 0.0]}, ["distorted", "rectified"]),
        ({}, {"distortion_model": "equidistant"}, ["distorted", "equidistant"]),
        ({}, {"width": 64}, ["64 x 96", "128 x 96"]),
        ({}, {"height": 0, "width": 0}, ["0 x 0"]),
        ({}, {"k": [0.0] * 9}, ["focal lengths over 0"]),
        ({}, {"k": [float("nan")] * 9}, ["focal lengths over 0"]),
        ({}, {"header": Header(stamp=STAMP, frame_id="colour")}, ["'colour'", FRAME]),
        ({}, {"binning_x": 2}, ["binning of 2"]),
        ({}, {"roi": RegionOfInterest(x_offset=8)}, ["region at 8"]),
        ({"data": array("B", bytes(2 * HEIGHT * WIDTH))}, {}, ["none of the", "reading"]),
    ],
)
def test_what_does_not_fit_is_named(depth: dict, camera: dict, words: list[str]) -> None:
    with pytest.raises(CloudError) as error:
        cloud_from_depth(depth_image(**depth), info(STAMP, **camera), None)
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (image(MASK.astype("<f4"), "32FC1", STAMP), ["mask", "'32FC1'", "32SC1"]),
        (image(MASK[:, :64], "mono8", STAMP, step=64), ["mask", "64 x 96"]),
        (image(MASK, "mono8", STAMP, frame="colour"), ["mask", "'colour'"]),
    ],
)
def test_a_mask_that_does_not_fit_is_named(mask: Any, words: list[str]) -> None:
    with pytest.raises(CloudError) as error:
        cloud_from_depth(depth_image(), info(STAMP), mask)
    assert all(word in str(error.value) for word in words), error.value

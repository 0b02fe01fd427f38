"""A depth camera of a test: images of a table with two boxes, their camera_info and mask."""

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from cell_processes import in_executor
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from server_client import Client
from std_msgs.msg import Header

from megrasp_ros.qos import SENSOR

FRAME = "camera_depth_optical_frame"
HEIGHT, WIDTH, FOCAL = 96, 128, 120.0
K = [FOCAL, 0.0, WIDTH / 2, 0.0, FOCAL, HEIGHT / 2, 0.0, 0.0, 1.0]
LOW, HIGH = 1, 2
"""Labels of the boxes: one of 6 cm, one of 10 cm."""

PLACES = {LOW: (0.09, 0.0, 0.54), HIGH: (-0.0833, 0.0, 0.50)}
"""Middles of their tops in the camera's frame (m)."""


def scene() -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Depth (m) and mask of the table, 0.6 m below the camera; the first row has no reading."""
    depth = np.full((HEIGHT, WIDTH), 0.6)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    depth[44:53, 80:89], mask[44:53, 80:89] = 0.54, LOW
    depth[43:54, 39:50], mask[43:54, 39:50] = 0.50, HIGH
    depth[0] = 0.0
    return depth, mask


def image(
    numbers: NDArray, encoding: str, stamp: Any, *, frame: str = FRAME, **fields: Any
) -> Image:
    """Return an Image of one channel, whose bytes are those of `numbers` (height, width)."""
    filled = {
        "height": numbers.shape[0],
        "width": numbers.shape[1],
        "encoding": encoding,
        "step": numbers.strides[0],
        "data": array("B", numbers.tobytes()),
        **fields,
    }
    return Image(header=Header(stamp=stamp, frame_id=frame), **filled)


def info(stamp: Any, **fields: Any) -> CameraInfo:
    """Return the camera_info of the scene, with other fields where they are given."""
    filled = {
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": K,
        "header": Header(stamp=stamp, frame_id=FRAME),
        **fields,
    }
    return CameraInfo(**filled)


def messages(stamp: Any) -> dict[str, Any]:
    """Return what the camera publishes at a moment, by topic."""
    depth, mask = scene()
    return {
        "depth": image((1000 * depth).round().astype("<u2"), "16UC1", stamp),
        "camera_info": info(stamp),
        "mask": image(mask, "mono8", stamp),
    }


@contextmanager
def depth_camera(
    client: Client,
    change: Callable[[dict[str, Any]], None] = lambda sent: None,
    *,
    late: float = 0.0,
    rate: float = 10.0,
) -> Iterator[None]:
    """Publish the scene while the context lasts.

    change: of the messages before they are sent; those it takes out have no publisher.
    late: the mask comes so long after the rest (s).
    """
    now = client.node.get_clock().now
    first = messages(now().to_msg())
    change(first)
    publishers = {
        name: client.node.create_publisher(type(sent), name, SENSOR)
        for name, sent in first.items()
    }
    stop = threading.Event()

    def publish() -> None:
        waiting: list[tuple[float, Image]] = []
        while not stop.wait(1.0 / rate):
            sent = messages(now().to_msg())
            change(sent)
            if late and "mask" in sent:
                waiting.append((time.monotonic() + late, sent.pop("mask")))
                while waiting and waiting[0][0] < time.monotonic():
                    publishers["mask"].publish(waiting.pop(0)[1])
            for name, message in sent.items():
                publishers[name].publish(message)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        for publisher in publishers.values():
            in_executor(client.node, lambda p=publisher: client.node.destroy_publisher(p))

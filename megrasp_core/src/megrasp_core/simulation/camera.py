"""Pinhole depth cameras without OpenGL: rays against the visual geometry.

Optical frame: x right, y down, z forward. A depth image holds the z coordinate in that frame in m,
0 where nothing was seen within `far`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.ranges import FROM_ONE, POSITIVE, Range, check_ranges


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with square pixels and the principal point in the middle of the image.

    world_from_camera: optical frame (4, 4). fovy: vertical field of view, rad. far: range, m.
    """

    world_from_camera: NDArray[np.float64]
    width: int = 640
    height: int = 480
    fovy: float = 0.75
    far: float = 2.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_ranges(
            self,
            width=FROM_ONE,
            height=FROM_ONE,
            fovy=Range(above=0, below=np.pi, unit="rad"),
            far=POSITIVE,
        )

    @property
    def position(self) -> NDArray[np.float64]:
        """Where the camera is, world frame, (3,) in m."""
        return np.asarray(self.world_from_camera[:3, 3], dtype=np.float64)

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.height / float(np.tan(0.5 * self.fovy))

    def intrinsics(self) -> NDArray[np.float64]:
        """Camera matrix K (3, 3) as ROS' camera_info has it."""
        f = self.focal
        return np.array(
            [[f, 0, (self.width - 1) / 2.0], [0, f, (self.height - 1) / 2.0], [0, 0, 1.0]]
        )

    def rays(self) -> NDArray[np.float64]:
        """Direction of each pixel in the optical frame with z = 1, (height, width, 3)."""
        k = self.intrinsics()
        u = (np.arange(self.width) - k[0, 2]) / k[0, 0]
        v = (np.arange(self.height) - k[1, 2]) / k[1, 1]
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = u
        rays[..., 1] = v[:, None]
        return rays


def look_at(
    position: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    right: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """World-from-optical pose (4, 4) of a camera at `position` that looks at `target`.

    right: wished direction of the image's x axis in the world; by default horizontal, and world x
        for a camera that looks straight down.
    """
    forward = np.asarray(target, dtype=np.float64) - position
    forward = forward / np.linalg.norm(forward)
    if right is None:
        right = np.cross(forward, [0.0, 0.0, 1.0])
        if np.linalg.norm(right) < 1e-6:
            right = np.array([1.0, 0.0, 0.0])
    x = np.asarray(right, dtype=np.float64) - forward * float(forward @ right)
    x = x / np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(forward, x), forward], axis=1)
    pose[:3, 3] = position
    return pose


def TopDownCamera(
    height: float = 0.85,
    *,
    centre: tuple[float, float] = (0.0, 0.0),
    width_px: int = 640,
    height_px: int = 480,
    fovy: float = 0.50,
) -> Camera:
    """Camera `height` m above `centre`, looking along -z with image x along world x.

    The default sees 0.58 x 0.43 m of the support: a bin of 40 x 30 cm and its rim with a margin.
    """
    position = np.array([*centre, height])
    pose = look_at(position, position - [0.0, 0.0, 1.0])
    return Camera(pose, width_px, height_px, fovy)


def ring_cameras(
    count: int = 10,
    *,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.03),
    distance: float = 0.75,
    elevation: tuple[float, float] = (0.6, 1.1),
    width_px: int = 320,
    height_px: int = 240,
    fovy: float = 0.65,
) -> list[Camera]:
    """Cameras around a point, by turns low and high, which look at it.

    Args:
        count: how many.
        centre: (3,) the point, world frame (m).
        distance: from it (m).
        elevation: the low and the high one over level (rad).
        width_px: of the images.
        height_px: of the images.
        fovy: vertical field of view (rad).
    """
    cameras = []
    for index in range(count):
        azimuth = 2.0 * np.pi * index / count
        lift = elevation[index % 2]
        offset = distance * np.array(
            [np.cos(lift) * np.cos(azimuth), np.cos(lift) * np.sin(azimuth), np.sin(lift)]
        )
        pose = look_at(np.asarray(centre) + offset, np.asarray(centre, dtype=np.float64))
        cameras.append(Camera(pose, width_px, height_px, fovy))
    return cameras


def depth_to_points(depth: NDArray[np.floating], camera: Camera) -> NDArray[np.float64]:
    """World points (N, 3) of the pixels that saw something (depth > 0), row by row."""
    seen = depth > 0
    local = camera.rays()[seen] * depth[seen][:, None]
    pose = camera.world_from_camera
    return local @ pose[:3, :3].T + pose[:3, 3]

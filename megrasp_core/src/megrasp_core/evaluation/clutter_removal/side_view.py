"""One depth camera beside the table, and the noise of the depth images that the papers have."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.errors import InvalidRequestError
from megrasp_core.pointcloud import Cloud
from megrasp_core.simulation import Camera, depth_to_points, sparse_camera

from .world import EDGE, ClutterWorld

SideNoise = Literal["gaussian", "dexnet", "none"]
"""gaussian: every point is moved by 0.8 mm (standard deviation, along each axis), as in the
simulator of Edge-Grasp. dexnet: as GIGA, after J. Mahler and others, Dex-Net 2.0, arXiv
1703.09312: all depths times one number of the gamma distribution with mean 1 and standard
deviation 3.2 %, and Gaussian noise of 5 mm that neighbours within 1.4 pixels share."""

DISTANCE = (2.0 * EDGE, 2.5 * EDGE)
ELEVATION = (np.pi / 6, np.pi / 4)
"""Of the camera: how far from the middle (m), how steeply it looks down (rad)."""
FOCAL, WIDTH, HEIGHT = 540.0, 640, 480
GAUSSIAN = 0.0008
GAMMA_SHAPE = 1000.0
PROCESS_SIGMA, PROCESS_BANDWIDTH = 0.005, np.sqrt(2.0)


def side_camera(rng: np.random.Generator) -> Camera:
    """Draw a camera that looks at the workspace from any side, 30 to 45 degrees down."""
    return sparse_camera(
        rng,
        centre=(0.0, 0.0, 0.05),
        distance=DISTANCE,
        elevation=ELEVATION,
        width_px=WIDTH,
        height_px=HEIGHT,
        fovy=2.0 * float(np.arctan(HEIGHT / 2 / FOCAL)),
    )


def look(world: ClutterWorld, camera: Camera, noise: SideNoise, rng: np.random.Generator) -> Cloud:
    """Cloud in the world frame of what the camera sees; the hand is never in it.

    Raises:
        InvalidRequestError: there is no such noise.
    """
    if noise not in get_args(SideNoise):
        raise InvalidRequestError(
            f"noise {noise!r} was given; expected one of {', '.join(get_args(SideNoise))}."
        )
    depth = world.depth_image(camera)
    if noise == "dexnet":
        depth = dexnet_noise(depth, rng)
    points = depth_to_points(depth, camera)
    if noise == "gaussian":
        points = points + rng.normal(0.0, GAUSSIAN, points.shape)
    return Cloud(points, viewpoint=camera.position)


def dexnet_noise(depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float64]:
    """A depth image (h, w) in m with the noise of Dex-Net 2.0; 0 stays 0."""
    factor = rng.gamma(GAMMA_SHAPE, 1.0 / GAMMA_SHAPE)
    process = ndimage.gaussian_filter(
        rng.standard_normal(depth.shape), PROCESS_BANDWIDTH / np.sqrt(2.0)
    )
    process *= PROCESS_SIGMA / process.std()
    return np.where(depth > 0, factor * depth + process, 0.0)

"""Clouds of bins and tables by construction: boxes as a depth camera sees them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.meshes import Mesh, RayScene
from megrasp_core.objects import box
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.simulation import look_at

FloatArray = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])
ABOVE = np.array([0.03, -0.02, 0.95])
"""A camera over the middle."""
ASIDE = np.array([0.15, -0.75, 0.80])
"""A camera that looks obliquely."""


def block(low: ArrayLike, high: ArrayLike) -> Mesh:
    """A box between two corners."""
    a, b = np.asarray(low, np.float64), np.asarray(high, np.float64)
    solid = box((b - a).tolist())
    return Mesh(solid.vertices + (a + b) / 2, solid.faces)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw: float = 0.0, tilt: float = 0.0):
    """(4, 4): turned by `tilt` about x, then by `yaw` about z (degrees)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xz", [tilt, yaw], degrees=True).as_matrix()
    matrix[:3, 3] = x, y, z
    return matrix


def bin_meshes(
    world_from_bin: FloatArray,
    inner: Sequence[float] = (0.40, 0.30, 0.15),
    wall: float = 0.008,
    ledge: float = 0.0,
) -> tuple[list[Mesh], OrientedBox]:
    """Floor, walls and perhaps an outer ledge of a bin whose floor's middle is the frame's origin;
    and its inside.
    """
    x, y, z = inner[0] / 2, inner[1] / 2, inner[2]
    out = wall + ledge
    parts = [block((-x - wall, -y - wall, -0.004), (x + wall, y + wall, 0.0))]
    for sign in (-1, 1):
        near, far = sorted((sign * x, sign * (x + wall)))
        parts.append(block((near, -y - wall, 0.0), (far, y + wall, z)))
        near, far = sorted((sign * y, sign * (y + wall)))
        parts.append(block((-x, near, 0.0), (x, far, z)))
        if ledge:
            near, far = sorted((sign * x, sign * (x + out)))
            parts.append(block((near, -y - out, z - 0.004), (far, y + out, z)))
            near, far = sorted((sign * y, sign * (y + out)))
            parts.append(block((-x, near, z - 0.004), (x, far, z)))
    middle = np.eye(4)
    middle[2, 3] = z / 2
    inside = OrientedBox(world_from_bin @ middle, np.array(inner))
    return [part.moved(world_from_bin) for part in parts], inside


def contents(
    inside: OrientedBox, height: float, seed: int = 0, count: int = 40, edge: float = 0.05
) -> list[Mesh]:
    """Blocks all over the inside whose tops lie about `height` over its floor (m)."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        size = rng.uniform(0.6 * edge, edge, 3)
        room = inside.size[:2] / 2 - 0.5 * edge
        place = np.eye(4)
        place[:3, :3] = Rotation.from_euler("z", rng.uniform(0, np.pi)).as_matrix()
        top = height + rng.uniform(-0.02, 0.0) - inside.size[2] / 2
        place[:3, 3] = [*rng.uniform(-room, room), top - size[2] / 2]
        found.append(block(-size / 2, size / 2).moved(inside.world_from_box @ place))
    return found


def table(half: float = 0.6) -> Mesh:
    """A table whose top is z = 0."""
    return block((-half, -half, -0.02), (half, half, 0.0))


def seen(
    meshes: Sequence[Mesh],
    camera: FloatArray = ABOVE,
    *,
    target: Sequence[float] = (0.0, 0.0, 0.05),
    noise: float = 0.0007,
    pixels: int = 300,
    view: float = 50.0,
    seed: int = 0,
) -> Cloud:
    """What a camera at `camera` sees that looks at `target`, in the world.

    Args:
        meshes: all there is.
        camera: (3,) its place.
        target: (3,) what is in the middle of the picture.
        noise: standard deviation along the ray (m).
        pixels: of an edge of the square picture.
        view: angle of the picture (degrees).
        seed: of the noise.
    """
    axes = look_at(camera, np.asarray(target, np.float64))[:3, :3]
    reach = np.tan(np.deg2rad(view / 2))
    u, v = np.meshgrid(*2 * [np.linspace(-reach, reach, pixels)])
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays = rays @ axes.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    start = np.broadcast_to(camera, rays.shape)
    depth = (
        RayScene(meshes).cast(np.concatenate([start, rays], axis=1)).distance.astype(np.float64)
    )
    hit = np.isfinite(depth)
    depth = depth + np.random.default_rng(seed).normal(0, noise, depth.shape)
    return Cloud(camera + rays[hit] * depth[hit, None], None, np.asarray(camera, np.float64))

"""A small software renderer: points with a depth buffer, no display and no graphics library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from megrasp_core.meshes import Mesh, joined, sample_uniform

__all__ = [
    "Canvas",
    "Projection",
    "height_colours",
    "look_along",
    "segment_points",
    "surface_samples",
]

BACKGROUND = np.array([0.96, 0.96, 0.97])


@dataclass(frozen=True)
class Projection:
    """An orthographic view.

    Attributes:
        rotation: (3, 3) view_from_world; rows: image right, image down, away from the viewer.
        centre: (3,) world point in the middle of the image.
        scale: pixels per metre.
        size: (width, height) in pixels.
    """

    rotation: np.ndarray
    centre: np.ndarray
    scale: float
    size: tuple[int, int]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Columns, rows (pixels) and depths (m) of world points (N, 3)."""
        local = (points - self.centre) @ self.rotation.T
        local[:, :2] *= self.scale
        local[:, 0] += self.size[0] / 2
        local[:, 1] += self.size[1] / 2
        return local


def look_along(direction: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a view along `direction` (3,) with `up` (3,) towards the image's top."""
    forward = direction / np.linalg.norm(direction)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


class Canvas:
    """Colour (H, W, 3) in 0..1 and depth (H, W) of what was drawn, the nearest on top."""

    def __init__(self, view: Projection) -> None:
        self.view = view
        width, height = view.size
        self.colour = np.tile(BACKGROUND, (height, width, 1))
        self.depth = np.full((height, width), np.inf)
        self.solid = np.zeros((height, width), dtype=bool)

    def copy(self) -> Canvas:
        """A canvas with the same content."""
        other = Canvas(self.view)
        other.colour, other.depth = self.colour.copy(), self.depth.copy()
        other.solid = self.solid.copy()
        return other

    def draw(
        self,
        points: np.ndarray,
        colours: np.ndarray,
        radius: float = 1.0,
        *,
        lift: float = 0.0,
        shaded: bool = True,
    ) -> None:
        """Draw points as small disks.

        Args:
            points: (N, 3) world.
            colours: (N, 3) or (3,), 0..1.
            radius: of a disk (pixels).
            lift: how much nearer to the viewer than they are (m): lets lines win over a surface.
            shaded: whether `shade` treats the pixels as a surface.
        """
        if len(points) == 0:
            return
        width, height = self.view.size
        screen = self.view.project(np.asarray(points, dtype=np.float64))
        pixel = np.floor(screen[:, :2]).astype(np.int64)
        depth = screen[:, 2] - lift
        colours = np.broadcast_to(np.asarray(colours, dtype=np.float64), (len(points), 3))
        reach = int(np.ceil(radius))
        flat = self.depth.reshape(-1)
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                if dx * dx + dy * dy > radius * radius + 0.25:
                    continue
                x, y = pixel[:, 0] + dx, pixel[:, 1] + dy
                ok = (x >= 0) & (x < width) & (y >= 0) & (y < height)
                index, near, paint = y[ok] * width + x[ok], depth[ok], colours[ok]
                np.minimum.at(flat, index, near)
                top = near <= flat[index]
                self.colour.reshape(-1, 3)[index[top]] = paint[top]
                self.solid.reshape(-1)[index[top]] = shaded

    def fill(self, passes: int = 2) -> None:
        """Close single empty pixels between drawn ones with the nearest neighbour's colour."""
        for _ in range(passes):
            empty = ~np.isfinite(self.depth)
            around = ndimage.uniform_filter((~empty).astype(float), 3, mode="constant") * 9
            hole = empty & (around > 3.5)
            if not hole.any():
                return
            nearest = ndimage.distance_transform_edt(
                empty, return_distances=False, return_indices=True
            )
            rows, columns = np.asarray(nearest)
            source = rows[hole], columns[hole]
            self.depth[hole] = self.depth[source]
            self.colour[hole] = self.colour[source]
            self.solid[hole] = self.solid[source]

    def shade(self, strength: float = 0.55, smooth: float = 1.6) -> None:
        """Light the surfaces from the upper left by the slope of the depth image.

        Args:
            strength: 0 leaves the colours as they are.
            smooth: pixels over which the slope is averaged: noise of the sensor.
        """
        known = np.isfinite(self.depth)
        if not known.any():
            return
        depth = np.where(known, self.depth, self.depth[known].max())
        depth = ndimage.median_filter(depth, size=5) * self.view.scale
        slope_y, slope_x = np.gradient(ndimage.gaussian_filter(depth, smooth))
        normal = np.stack([slope_x, slope_y, -np.ones_like(depth)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        light = np.array([-0.45, -0.55, -0.7])
        lit = np.clip(normal @ (light / np.linalg.norm(light)), 0.0, 1.0)
        factor = np.where(self.solid & known, 1.0 - strength + strength * 1.15 * lit, 1.0)
        self.colour = np.clip(self.colour * factor[..., None], 0.0, 1.0)

    def image(self) -> np.ndarray:
        """(H, W, 3) uint8."""
        return (self.colour * 255.0 + 0.5).astype(np.uint8)


def surface_samples(meshes: Sequence[Mesh], spacing: float, seed: int = 0) -> np.ndarray:
    """Points (N, 3) on triangle meshes, about one per square of this spacing (m)."""
    mesh = joined(meshes)
    count = int(np.clip(2.0 * mesh.area / spacing**2, 100, 400_000))
    return sample_uniform(mesh, count, np.random.default_rng(seed))[0]


def segment_points(start: np.ndarray, end: np.ndarray, spacing: float) -> np.ndarray:
    """Points (N, 3) along a segment."""
    count = max(2, int(np.ceil(np.linalg.norm(end - start) / spacing)) + 1)
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


def height_colours(x: np.ndarray) -> np.ndarray:
    """Dark slate, teal, sand, light: ordered in brightness, away from the ranks' green and red."""
    stops = np.array([0.0, 0.35, 0.7, 1.0])
    table = np.array(
        [[0.33, 0.36, 0.43], [0.42, 0.56, 0.66], [0.80, 0.74, 0.62], [0.97, 0.94, 0.90]]
    )
    x = np.clip(x, 0.0, 1.0)
    return np.stack([np.interp(x, stops, table[:, i]) for i in range(3)], axis=1)

"""A picture of one scene as a depth camera sees it, clean and noisy (`megrasp data look`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image

from megrasp_core.pointcloud import Cloud
from megrasp_core.simulation import Camera, DepthNoise, Light, World, look_at, observe, render_view

_LOST = {
    "far_wall": "#d62728",
    "range": "#8c564b",
    "shiny": "#2ca02c",
    "shadow": "#9467bd",
    "steep": "#ff7f0e",
    "edges": "#1f77b4",
}
"""Effects that lose pixels; one lost through several is drawn as the first."""
_SIDE = 420


def noise_picture(
    world: World,
    cameras: Sequence[Camera],
    noise: DepthNoise | None,
    seed: int,
    light: Light,
    file: str | Path,
    title: str,
) -> Path:
    """Write a PNG; return its path.

    Above the depth image of the first camera, clean and noisy, and which effect lost which pixel;
    below the cloud of all cameras, clean and noisy, and the error of the depth that came back.

    Args:
        world: the scene.
        cameras: that look at it.
        noise: of all of them; None: none.
        seed: of the noise.
        light: of the scene.
        file: the PNG.
        title: over the picture.
    """

    def generator() -> np.random.Generator:
        return np.random.default_rng(seed)

    view = render_view(world, cameras[0])
    noisy = view.depth if noise is None else noise.apply(view, generator())
    figure = Figure(figsize=(13.0, 8.0))
    axes = figure.subplots(2, 3)
    figure.subplots_adjust(0.01, 0.06, 0.99, 0.91, wspace=0.03, hspace=0.24)
    seen = view.depth > 0
    near, far = float(view.depth[seen].min()), float(np.percentile(view.depth[seen], 99))
    for axis, depth, name in ((axes[0, 0], view.depth, "clean"), (axes[0, 1], noisy, "noisy")):
        image = axis.imshow(
            np.where(depth > 0, depth, np.nan), cmap="viridis_r", vmin=near, vmax=far
        )
        axis.set_title(f"depth (m), {name}: {100 * np.mean(depth > 0):.1f} % came back")
        _scale(axis, image)
    _lost(axes[0, 2], view.depth, noisy, _who(world, cameras[0], noise, seed))
    clouds = (
        observe(world, list(cameras), light=light),
        observe(world, list(cameras), noise, generator(), light),
    )
    for axis, cloud, name in zip(axes[1], clouds, ("clean", "noisy"), strict=False):
        axis.imshow(_drawn(cloud, cameras[0]))
        axis.set_title(f"cloud, {name}: {len(cloud):,} points")
    back = noisy > 0
    error = np.where(back, 1000.0 * (noisy - view.depth), np.nan)
    spread = float(np.nanmedian(np.abs(error))) if back.any() else 0.0
    bound = max(4.0 * spread, 0.5)
    image = axes[1, 2].imshow(error, cmap="RdBu", vmin=-bound, vmax=bound)
    axes[1, 2].set_title(f"error of depth (mm): median {spread:.2f}")
    _scale(axes[1, 2], image)
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[], facecolor="black")
    figure.suptitle(title)
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=85)
    # Noise does not compress; a palette makes the file half as large.
    Image.open(path).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    return path


def _scale(axis: Axes, image: AxesImage) -> None:
    bar = axis.inset_axes((0.15, -0.07, 0.7, 0.03))
    bar.figure.colorbar(image, cax=bar, orientation="horizontal")


def _who(
    world: World, camera: Camera, noise: DepthNoise | None, seed: int
) -> dict[str, NDArray[np.bool_]]:
    """Which pixels (h, w) each effect loses by itself."""
    if noise is None:
        return {}
    view = render_view(world, camera)
    return {
        name: (view.depth > 0) & (noise.only(name).apply(view, np.random.default_rng(seed)) == 0)
        for name in _LOST
        if name not in noise.off
    }


def _lost(
    axis: Axes,
    clean: NDArray[np.float32],
    noisy: NDArray[np.float32],
    who: dict[str, NDArray[np.bool_]],
) -> None:
    label = np.where(clean > 0, 0, 1)
    names = list(_LOST)
    for name in reversed([name for name in names if name in who]):
        label[who[name] & (noisy == 0)] = 2 + names.index(name)
    colours = ["#d0d0d0", "black", *_LOST.values()]
    axis.imshow(
        label,
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=len(colours) - 0.5,
        interpolation="nearest",
    )
    axis.set_title("lost through")
    handles = [
        Patch(
            color=_LOST[name],
            label=f"{name} {100 * np.mean(label == 2 + names.index(name)):.1f} %",
        )
        for name in names
        if (label == 2 + names.index(name)).any()
    ]
    if handles:
        axis.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            ncols=3,
            frameon=False,
            fontsize=9,
            columnspacing=1.0,
            handlelength=1.2,
        )


def _drawn(cloud: Cloud, seen_from: Camera) -> NDArray[np.float64]:
    """The cloud as squares of 2 pixels, nearest in front, from 50 degrees beside the camera."""
    centre = np.array([0.0, 0.0, 0.05])
    away = seen_from.position - centre
    azimuth = np.arctan2(away[1], away[0]) if np.hypot(*away[:2]) > 0.1 else -np.pi / 2
    azimuth += np.deg2rad(50.0)
    position = centre + 0.9 * np.array([0.5 * np.cos(azimuth), 0.5 * np.sin(azimuth), 0.87])
    camera = Camera(look_at(position, centre), 640 * _SIDE // 480, _SIDE, 0.55)
    pose, k = camera.world_from_camera, camera.intrinsics()
    local = (cloud.points - pose[:3, 3]) @ pose[:3, :3]
    pixel = np.round(local[:, :2] / local[:, 2:] * k[0, 0] + k[:2, 2]).astype(int)
    inside = (local[:, 2] > 0) & (pixel >= 0).all(axis=1)
    inside &= (pixel < [camera.width - 1, camera.height - 1]).all(axis=1)
    order = np.argsort(-local[inside, 2])
    u, v = pixel[inside][order].T
    image = np.ones((camera.height, camera.width, 3))
    colors = np.full_like(cloud.points, 0.5) if cloud.colors is None else cloud.colors
    for right in (0, 1):
        for down in (0, 1):
            image[v + down, u + right] = colors[inside][order]
    return image

"""Where cameras stand: the three ways in which a scene is looked at."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .camera import Camera, TopDownCamera, look_at, ring_cameras

ViewName = Literal["dense", "sparse", "top_down"]
"""dense: ten views around, fused. sparse: one oblique view. top_down: one view from above."""


def sparse_camera(
    rng: np.random.Generator,
    *,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.03),
    distance: tuple[float, float] = (0.65, 0.85),
    elevation: tuple[float, float] = (0.6, 1.1),
    width_px: int = 640,
    height_px: int = 480,
    fovy: float = 0.65,
) -> Camera:
    """One camera that looks at a point from any side; side, elevation and distance are drawn
    evenly.

    Args:
        rng: of the draws.
        centre: (3,) the point, world frame (m).
        distance: least and largest (m).
        elevation: least and largest over level (rad).
        width_px: of the image.
        height_px: of the image.
        fovy: vertical field of view (rad).
    """
    azimuth, lift = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*elevation)
    away = [np.cos(lift) * np.cos(azimuth), np.cos(lift) * np.sin(azimuth), np.sin(lift)]
    target = np.asarray(centre, dtype=np.float64)
    pose = look_at(target + rng.uniform(*distance) * np.array(away), target)
    return Camera(pose, width_px, height_px, fovy)


def rig(name: ViewName, rng: np.random.Generator | None = None) -> list[Camera]:
    """The cameras of a named view; `rng` places the camera of the sparse one.

    Raises:
        InvalidRequestError: another name, or "sparse" without rng.
    """
    if name == "dense":
        return ring_cameras()
    if name == "top_down":
        return [TopDownCamera()]
    if name == "sparse" and rng is not None:
        return [sparse_camera(rng)]
    if name == "sparse":
        raise InvalidRequestError("the sparse view was asked for without rng; pass a generator.")
    raise InvalidRequestError(
        f"unknown view {name!r}; expected one of {', '.join(get_args(ViewName))}."
    )

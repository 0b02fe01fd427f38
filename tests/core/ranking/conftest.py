"""Synthetic scenes of boxes, seen exactly by a pinhole camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

CAMERA = np.array([0.0, 0.0, 0.85])
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def ray_cast(
    boxes: Sequence[Box],
    camera: np.ndarray = CAMERA,
    *,
    half: tuple[float, float] = (0.24, 0.19),
    spacing: float = 0.0011,
) -> np.ndarray:
    """Points (N, 3) where rays from the camera hit axis-aligned boxes (low, high) or z = 0.

    One ray per square of this spacing on the floor, which reaches to +-half.
    """
    x = np.arange(-half[0], half[0], spacing)
    y = np.arange(-half[1], half[1], spacing)
    floor = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
    rays = floor - camera
    nearest = np.ones(len(rays))
    for low, high in boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            first = (np.asarray(low) - camera) / rays
            second = (np.asarray(high) - camera) / rays
        enter = np.fmin(first, second).max(axis=1)
        leave = np.fmax(first, second).min(axis=1)
        hit = (enter < leave) & (enter > 0)
        nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    return camera + rays * nearest[:, None]


@pytest.fixture(scope="session")
def seen() -> Callable[..., np.ndarray]:
    """`ray_cast`, cached by nothing: scenes are small."""
    return ray_cast


@pytest.fixture
def camera() -> np.ndarray:
    """Position of the camera of `seen`."""
    return CAMERA.copy()

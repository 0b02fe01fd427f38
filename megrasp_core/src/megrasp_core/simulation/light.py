"""Light and paint of a scene, for clouds with colours (`observe(..., light=...)`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Light:
    """One lamp far away and light from everywhere; matt surfaces, no shadows.

    direction: towards the lamp, unit vector in the world frame.
    ambient: share of the brightness that reaches surfaces turned away from the lamp.
    brightness: 1 shows a surface that faces the lamp in its own colour.
    tint: factor on red, green and blue.
    paint: seed of the colours that objects and bin are painted with; None leaves theirs.
    """

    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    ambient: float = 0.5
    brightness: float = 1.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    paint: int | None = None

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, paint: bool = True) -> Light:
        """A random lamp above the scene, and with `paint` random colours of what it shines on."""
        azimuth, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.35, 1.0)
        level = np.sqrt(1.0 - height**2)
        ambient, brightness = rng.uniform(0.25, 0.7), rng.uniform(0.6, 1.3)
        red, green, blue = rng.uniform(0.85, 1.15, size=3)
        seed = int(rng.integers(2**31))
        return cls(
            (float(level * np.cos(azimuth)), float(level * np.sin(azimuth)), float(height)),
            float(ambient),
            float(brightness),
            (float(red), float(green), float(blue)),
            seed if paint else None,
        )

    def painted(self, palette: NDArray[np.float64]) -> NDArray[np.float64]:
        """Colours (n, 3) of the things in a scene, half their own and half random if painted."""
        if self.paint is None:
            return palette
        random = np.random.default_rng(self.paint).uniform(0.0, 1.0, size=palette.shape)
        return 0.5 * (palette + random)

    def shaded(
        self, colors: NDArray[np.float64], normals: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Colours (n, 3) in 0..1 as the camera sees them on surfaces with unit normals (n, 3)."""
        facing = np.clip(normals @ np.asarray(self.direction), 0.0, None)
        level = self.brightness * (self.ambient + (1.0 - self.ambient) * facing)
        return np.clip(colors * level[:, None] * np.asarray(self.tint), 0.0, 1.0)

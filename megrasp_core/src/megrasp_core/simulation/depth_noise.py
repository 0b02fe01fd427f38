"""What a real depth camera does to a depth image (DESIGN section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.simulation.view import View


@dataclass(frozen=True)
class DepthNoise:
    """Noise of a depth image; `scaled` makes it stronger or weaker.

    axial_base, axial_square: standard deviation along the ray, base + square * z^2 (m, m per m^2),
        larger on slanted surfaces up to `slant_gain` times.
    correlated: share of its variance that neighbours within `correlation` pixels have in common.
    step_square: depth steps of square * z^2 (m per m^2), as disparity has.
    jump: depth step (m) that makes an edge; pixels at edges are lost with probability `edge_loss`
        or, with `edge_mix`, take a depth between front and back.
    steep: from (cosine of incidence) to (cosine) over which the loss grows from 0 to all.
    shiny_share: probability that an object is shiny; where such a surface faces the camera within
        `shiny_cosine`, and on random patches of it, nothing comes back.
    """

    axial_base: float = 0.0003
    axial_square: float = 0.0014
    slant_gain: float = 2.5
    correlated: float = 0.5
    correlation: float = 1.5
    step_square: float = 0.0007
    jump: float = 0.008
    edge_loss: float = 0.5
    edge_mix: float = 0.08
    steep: tuple[float, float] = (0.35, 0.10)
    shiny_share: float = 0.12
    shiny_cosine: float = 0.97
    shiny_patch: float = 0.25

    def scaled(self, factor: float) -> DepthNoise:
        """Return the same camera with its axial noise and depth steps multiplied."""
        values = dict(self.__dict__)
        for name in ("axial_base", "axial_square", "step_square"):
            values[name] = values[name] * factor
        return DepthNoise(**values)

    def apply(self, view: View, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the noisy depth image (h, w) in m, 0 where nothing came back."""
        clean = view.depth
        depth = clean.copy()
        lost = clean <= 0
        slant = 1.0 / np.clip(view.incidence, 1.0 / self.slant_gain, 1.0)
        sigma = (self.axial_base + self.axial_square * clean**2) * slant
        depth += sigma * self._unit_noise(clean.shape, rng)
        lost |= self._edges(depth, clean, rng)
        low, high = self.steep[1], self.steep[0]
        loss = np.clip((high - view.incidence) / (high - low), 0.0, 1.0)
        lost |= rng.random(clean.shape, dtype=np.float32) < loss
        lost |= self._shiny(view, rng)
        step = np.maximum(self.step_square * clean**2, 1e-6)
        depth = np.round(depth / step) * step
        depth[lost] = 0.0
        return depth.astype(np.float32)

    def _unit_noise(self, shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
        white = rng.standard_normal(shape, dtype=np.float32)
        if self.correlated <= 0:
            return white
        smooth = ndimage.gaussian_filter(
            rng.standard_normal(shape, dtype=np.float32), self.correlation, truncate=2.5
        )
        smooth /= max(float(smooth.std()), 1e-9)
        return np.sqrt(1 - self.correlated) * white + np.sqrt(self.correlated) * smooth

    def _edges(
        self,
        depth: NDArray[np.float32],
        clean: NDArray[np.float32],
        rng: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Mix depths at edges in place and return which pixels are lost there."""
        back = ndimage.maximum_filter(clean, 3)
        front = ndimage.minimum_filter(clean, 3)
        rows, columns = np.nonzero((back - front > self.jump) & (clean > 0))
        chance = rng.random(len(rows), dtype=np.float32)
        lost = np.zeros(clean.shape, dtype=bool)
        gone = chance < self.edge_loss
        lost[rows[gone], columns[gone]] = True
        mixed = ~gone & (chance < self.edge_loss + self.edge_mix)
        r, c = rows[mixed], columns[mixed]
        share = rng.random(len(r), dtype=np.float32)
        depth[r, c] = front[r, c] + share * (back[r, c] - front[r, c])
        lost[r, c] |= front[r, c] <= 0
        return lost

    def _shiny(self, view: View, rng: np.random.Generator) -> NDArray[np.bool_]:
        objects = int(view.owner.max(initial=-1)) + 1
        shiny = np.zeros(
            objects + 1, dtype=bool
        )  # the last entry is the support, which is never shiny
        shiny[:objects] = rng.random(objects) < self.shiny_share
        surface = shiny[view.owner]
        if not surface.any():
            return surface
        blobs = rng.random(tuple(-(-edge // 16) + 1 for edge in surface.shape))
        patch = np.asarray(ndimage.zoom(blobs, 16, order=1))[
            : surface.shape[0], : surface.shape[1]
        ]
        return surface & ((view.incidence > self.shiny_cosine) | (patch < self.shiny_patch))

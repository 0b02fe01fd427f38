"""What a real depth camera does to a depth image.

Every effect has a name in `EFFECTS` and can be switched off alone; a seed fixes all of them, and
what one effect draws does not depend on which others are on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from megrasp_core.errors import InvalidRequestError
from megrasp_core.ranges import LENGTH, SHARE, Range, check_ranges

from .view import View

EFFECTS = ("axial", "edges", "steep", "shiny", "quantisation", "shadow", "range", "far_wall")


@dataclass(frozen=True)
class DepthNoise:
    """Noise of a depth image; `scaled` makes it stronger or weaker, `only` and `without` switch
    effects by their names in EFFECTS.

    axial_base, axial_square: standard deviation along the ray, base + square * z^2 (m, m per m^2),
        larger on slanted surfaces up to `slant_gain` times ("axial").
    correlated: share of its variance that neighbours within `correlation` pixels have in common.
    step_square: depth steps of square * z^2 (m per m^2), as disparity has ("quantisation").
    disparity: work in disparity as a real camera does: all pixels share the same levels of depth,
        and a slanted plane has no edges. Otherwise each pixel's depth is rounded to its own step,
        with errors of the same size, and depth that changes fast is an edge.
    jump: depth step (m) that makes an edge; pixels at edges are lost with probability `edge_loss`
        or, with `edge_mix`, take a depth between front and back ("edges").
    steep: from (cosine of incidence) to (cosine) over which the loss grows from 0 to all
        ("steep").
    shiny_share: probability that an object is shiny; where such a surface faces the camera within
        `shiny_cosine`, and on random patches of it, nothing comes back ("shiny").
    baseline: how far the second eye or the projector is to the right of the camera (image x), m;
        what it cannot see behind something nearer is lost ("shadow"). 0: none.
    max_range: depth in m beyond which nothing comes back ("range"). None: the camera's own.
    far_wall: probability that the wall of the bin farthest from the camera does not come back
        ("far_wall"). Above 0 the view must know the walls.
    off: effects that are switched off.
    """

    axial_base: float = 0.0003
    axial_square: float = 0.0014
    slant_gain: float = 2.5
    correlated: float = 0.5
    correlation: float = 1.5
    step_square: float = 0.0007
    disparity: bool = False
    jump: float = 0.008
    edge_loss: float = 0.5
    edge_mix: float = 0.08
    steep: tuple[float, float] = (0.35, 0.10)
    shiny_share: float = 0.12
    shiny_cosine: float = 0.97
    shiny_patch: float = 0.25
    baseline: float = 0.0
    max_range: float | None = None
    far_wall: float = 0.0
    off: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(
            self,
            axial_base=LENGTH,
            axial_square=LENGTH,
            slant_gain=Range(1),
            correlated=SHARE,
            correlation=LENGTH,
            step_square=LENGTH,
            jump=LENGTH,
            edge_loss=SHARE,
            edge_mix=SHARE,
            steep=Range(0, 1, several=True),
            shiny_share=SHARE,
            shiny_cosine=SHARE,
            shiny_patch=SHARE,
            baseline=LENGTH,
            max_range=Range(above=0, optional=True, unit="m"),
            far_wall=SHARE,
        )
        """Check the names of the effects."""
        if len(self.steep) != 2 or self.steep[0] <= self.steep[1]:
            raise InvalidRequestError(
                f"steep {self.steep} was given; expected two cosines, the first one larger."
            )
        unknown = sorted(set(self.off) - set(EFFECTS))
        if unknown:
            raise InvalidRequestError(
                f"unknown effect {', '.join(unknown)}; expected names among {', '.join(EFFECTS)}."
            )

    def without(self, *effects: str) -> DepthNoise:
        """Return the same camera with these effects switched off as well."""
        return replace(self, off=tuple(sorted({*self.off, *effects})))

    def only(self, *effects: str) -> DepthNoise:
        """Return the same camera with all effects but these switched off."""
        kept = replace(self, off=effects)  # checks the names
        return replace(self, off=tuple(name for name in EFFECTS if name not in kept.off))

    def scaled(self, factor: float) -> DepthNoise:
        """Return the same camera with its axial noise and depth steps multiplied."""
        names = ("axial_base", "axial_square", "step_square")
        return replace(self, **{name: getattr(self, name) * factor for name in names})

    def apply(self, view: View, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the noisy depth image (h, w) in m, 0 where nothing came back.

        Raises:
            InvalidRequestError: shadow or far wall are asked for of a view that lacks the focal
                length or the walls that they need.
        """
        on = {name: name not in self.off for name in EFFECTS}
        clean = view.depth
        depth = clean.copy()
        lost = clean <= 0
        axial = self._sigma(view) * self._unit_noise(clean.shape, rng)
        if on["axial"]:
            depth += axial
        # What is off is drawn all the same, so that the others see the same random numbers.
        edges = self._edges(depth if on["edges"] else depth.copy(), clean, rng)
        low, high = self.steep[1], self.steep[0]
        loss = np.clip((high - view.incidence) / (high - low), 0.0, 1.0)
        steep = rng.random(clean.shape, dtype=np.float32) < loss
        shiny = self._shiny(view, rng)
        far_wall = self._far_wall(view, rng)
        for name, gone in (
            ("edges", edges),
            ("steep", steep),
            ("shiny", shiny),
            ("far_wall", far_wall),
        ):
            if on[name]:
                lost |= gone
        if on["shadow"] and self.baseline > 0:
            lost |= self._shadow(view)
        if on["range"] and self.max_range is not None:
            lost |= clean > self.max_range
        if on["quantisation"]:
            depth = self._rounded(depth, clean)
        depth[lost] = 0.0
        return depth.astype(np.float32)

    def _sigma(self, view: View) -> NDArray[np.floating]:
        slant = 1.0 / np.clip(view.incidence, 1.0 / self.slant_gain, 1.0)
        return (self.axial_base + self.axial_square * view.depth**2) * slant

    def _rounded(
        self, depth: NDArray[np.float32], clean: NDArray[np.float32]
    ) -> NDArray[np.floating]:
        if self.disparity and self.step_square > 0:
            steps = np.round(1.0 / (self.step_square * np.maximum(depth, 1e-3)))
            return 1.0 / (self.step_square * np.maximum(steps, 1.0))
        step = np.maximum(self.step_square * clean**2, 1e-6)
        return np.round(depth / step) * step

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
        step = _bend(clean) if self.disparity else back - front
        rows, columns = np.nonzero((step > self.jump) & (clean > 0))
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

    def _shadow(self, view: View) -> NDArray[np.bool_]:
        """Return what the second eye does not see, (h, w)."""
        if view.focal is None:
            raise InvalidRequestError(
                "a baseline was given for a view without focal length; expected View.focal in "
                "pixels. Render the view, or switch the effect off: without('shadow')."
            )
        seen = view.depth > 0
        disparity = view.focal * self.baseline / np.where(seen, view.depth, np.inf)
        # The column at which the second eye sees each pixel. In a row the order of columns is kept
        # but where something nearer, further to the right here, has moved in front.
        column = np.arange(view.depth.shape[1]) - disparity
        front = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
        hidden = np.zeros(seen.shape, dtype=bool)
        # A tenth of a pixel: neighbours on a face that the second eye looks along may tie.
        hidden[:, :-1] = column[:, :-1] > front[:, 1:] + 0.1
        return hidden & seen

    def _far_wall(self, view: View, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Return the inside of the bin's farthest wall if it is lost, (h, w)."""
        none = np.zeros(view.depth.shape, dtype=bool)
        if self.far_wall <= 0 or "far_wall" in self.off:
            return none
        if view.wall is None:
            raise InvalidRequestError(
                "far_wall was given for a view that does not know the walls; expected View.wall "
                "(h, w). Render the view, or set far_wall to 0."
            )
        inside = view.wall >= 0
        if rng.random() >= self.far_wall or not inside.any():
            return none
        total = np.bincount(view.wall[inside], weights=view.depth[inside])
        mean = total / np.maximum(np.bincount(view.wall[inside]), 1)
        return view.wall == int(np.argmax(mean))


def _bend(depth: NDArray[np.float32]) -> NDArray[np.floating]:
    """Depth step (m) at each pixel beyond what the slant of its surface makes, (h, w)."""
    # The inverse depth of a plane is linear over the image; nothing seen is infinitely far.
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    wide = np.pad(inverse, 1, mode="reflect", reflect_type="odd")
    along = wide[1:-1, 2:] - 2.0 * inverse + wide[1:-1, :-2]
    across = wide[2:, 1:-1] - 2.0 * inverse + wide[:-2, 1:-1]
    return np.maximum(np.abs(along), np.abs(across)) * depth.astype(np.float64) ** 2

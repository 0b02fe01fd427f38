"""The isotropic Gaussian on SO(3), IGSO3(sigma): heat kernel of the rotation group.

A rotation Exp(w n) has an axis n uniform on the sphere and an angle w in [0, pi] with the density
f(w; sigma) (1 - cos w) / pi; f is the density with respect to the normalised Haar measure, so
f -> 1 for large sigma. All sums run in float64 and return the dtype of the angles: the series
cancels by up to ten digits. The paper's t is sigma^2.
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError

from .igso3_forms import Values, series_form, small_form
from .igso3_quantiles import angle_ratio

Form = Literal["auto", "series", "small"]

SWITCH_SIGMA = 0.5
"""Below this sigma `auto` uses the small-sigma form."""

_SERIES_REACH = 9.0
"""Series terms up to l = reach / sigma: the first one left out is below exp(-40)."""

_MAX_TERMS = 2000


def log_density(w: Tensor, sigma: Tensor | float, form: Form = "auto") -> Tensor:
    """Logarithm of f(w; sigma), shapes broadcast; angles w in [0, pi] (rad), sigma > 0 (rad).

    `series` is the character expansion, good for sigma >= 0.5 (it cancels below, first near pi);
    `small` its Poisson resummation in log space, exact to rounding up to sigma about 1; `auto`
    takes the right one per element.
    """
    return evaluate(w, sigma, form).log_density


def density(w: Tensor, sigma: Tensor | float, form: Form = "auto") -> Tensor:
    """f(w; sigma), the density with respect to normalised Haar measure; see `log_density`."""
    return log_density(w, sigma, form).exp()


def score(w: Tensor, sigma: Tensor | float, form: Form = "auto") -> Tensor:
    """d/dw log f(w; sigma) (1/rad), shapes broadcast; analytic. 0 at w = 0 and w = pi."""
    return evaluate(w, sigma, form).score


def evaluate(w: Tensor, sigma: Tensor | float, form: Form = "auto") -> Values:
    """`log_density` and `score` at once, for less than twice the work.

    Raises:
        InvalidRequestError: an unknown form.
    """
    if form not in ("auto", "series", "small"):
        raise InvalidRequestError(f"got form {form!r}; expected 'auto', 'series' or 'small'")
    angle = w.to(torch.float64)
    scale = torch.as_tensor(sigma, dtype=torch.float64, device=w.device)
    angle, scale = torch.broadcast_tensors(angle, scale)
    if form == "small":
        values = small_form(angle, scale)
    elif form == "series":
        smallest = float(scale.min()) if scale.numel() else 1.0
        terms = min(_MAX_TERMS, math.ceil(_SERIES_REACH / smallest) + 2)
        values = series_form(angle, scale, terms)
    else:
        # Both forms on clamped sigmas and a choice by element: no synchronisation with the device.
        is_small = scale < SWITCH_SIGMA
        near = small_form(angle, scale.clamp(max=SWITCH_SIGMA))
        terms = math.ceil(_SERIES_REACH / SWITCH_SIGMA) + 2
        far = series_form(angle, scale.clamp(min=SWITCH_SIGMA), terms)
        values = Values(*(torch.where(is_small, a, b) for a, b in zip(near, far, strict=True)))
    return Values(values.log_density.to(w.dtype), values.score.to(w.dtype))


def sample(sigma: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Rotation vectors (..., 3) (rad) of draws from IGSO3(sigma), one per element of sigma (...).

    Inverse-CDF sampling (`igso3_quantiles`), monotone in the norm of three normal draws: with the
    same generator state noise of another sigma keeps its axis. Above sigma = 4 draws are uniform
    rotations.
    """
    g, norm = _gaussian(sigma, generator)
    return angle_ratio(norm, sigma)[..., None] * g


def _gaussian(sigma: Tensor, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
    g = torch.randn(*sigma.shape, 3, generator=generator, dtype=sigma.dtype, device=sigma.device)
    return g, (g * g).sum(-1).sqrt()

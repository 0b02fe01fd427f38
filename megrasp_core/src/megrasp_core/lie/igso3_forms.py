"""The two forms of the isotropic Gaussian's density on SO(3), with slopes, in float64.

See `megrasp_core.lie.igso3` for the conventions and for which one to use.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor


class Values(NamedTuple):
    """log f and d/dw log f, equal shapes."""

    log_density: Tensor
    score: Tensor


def series_form(angle: Tensor, sigma: Tensor, terms: int) -> Values:
    """Character expansion; sin((l+1/2)w)/sin(w/2) = 1 + 2 sum_{k<=l} cos kw: no 0/0 at w = 0."""
    degree = torch.arange(terms, dtype=torch.float64, device=angle.device)
    exponent = -0.5 * degree * (degree + 1) * (sigma * sigma)[..., None]
    weight = (2 * degree + 1) * exponent.exp()
    tail = weight.flip(-1).cumsum(-1).flip(-1)
    phase = angle[..., None] * degree
    factor = torch.full_like(degree, 2.0)
    factor[0] = 1.0
    value = (tail * factor * phase.cos()).sum(-1)
    slope = -(tail * factor * degree * phase.sin()).sum(-1)
    # For a sigma too small for this form rounding can make the sum negative near pi.
    value = value.clamp(min=torch.finfo(torch.float64).tiny)
    return Values(value.log(), slope / value)


def small_form(angle: Tensor, sigma: Tensor) -> Values:
    """Small-sigma form in log space, e = sigma^2 / 2, with its w -> 0 limits taken analytically.

    f = sqrt(pi) e^-1.5 exp(e/4 - w^2/(4e)) (w / (2 sin(w/2))) B with
    B = 1 - exp(-pi^2/e) (2 cosh x - (4 pi^2/e) sinh(x)/x), x = pi w / e.
    """
    e = 0.5 * sigma * sigma
    tiny = angle < 1e-3
    w = torch.where(tiny, torch.ones_like(angle), angle)
    half = 0.5 * w
    lens = torch.where(tiny, angle.square() / 24, (half / half.sin()).log())
    lens_slope = torch.where(tiny, angle / 12, 1 / w - 0.5 * half.cos() / half.sin())

    x = math.pi * angle / e
    full = math.pi * math.pi / e
    up, down = 0.5 * (x - full).exp(), 0.5 * (-x - full).exp()
    cosh, sinh = up + down, up - down
    flat = x < 1e-2
    safe = torch.where(flat, torch.ones_like(x), x)
    base = (-full).exp()
    sinhc = torch.where(flat, base * (1 + x.square() / 6), sinh / safe)
    sinhc_slope = torch.where(flat, base * x / 3, (cosh - sinh / safe) / safe)
    bracket = 1 - 2 * cosh + 4 * full * sinhc
    bracket_slope = (math.pi / e) * (-2 * sinh + 4 * full * sinhc_slope)

    log_value = (
        0.5 * math.log(math.pi)
        - 1.5 * e.log()
        + 0.25 * e
        - angle.square() / (4 * e)
        + lens
        + bracket.log()
    )
    return Values(log_value, -angle / (2 * e) + lens_slope + bracket_slope / bracket)

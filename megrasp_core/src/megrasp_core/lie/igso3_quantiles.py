"""Quantiles of the isotropic Gaussian's angle on SO(3), for sampling.

A standard Gaussian 3-vector g has a Maxwell-distributed norm m. The monotone map that carries the
Maxwell distribution to that of the angle turns g into a rotation vector. For small sigma the map
is sigma m, so what is tabulated is the smooth angle / sigma over (log sigma, m).
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from .igso3_forms import series_form, small_form

LOWEST_SIGMA = 0.01
"""Below, its quantiles over sigma serve; they differ from their limit by less than 1e-5."""
HIGHEST_SIGMA = 4.0
"""Above, the distribution is uniform over rotations to 1e-6."""
_ROWS = 257
_HIGHEST_NORM = 6.5
_COLUMNS = 521
_QUADRATURE = 2049


def angle_ratio(norm: Tensor, sigma: Tensor) -> Tensor:
    """Angle per unit of the Gaussian's norm (rad), shapes (...) equal; norm times it is <= pi.

    Bilinear look-up. The table is a constant, computed at the first call for a dtype and device.
    """
    table = _quantile_table(sigma.dtype, sigma.device)
    row = (sigma / LOWEST_SIGMA).log() * ((_ROWS - 1) / math.log(HIGHEST_SIGMA / LOWEST_SIGMA))
    row = row.clamp(0, _ROWS - 1)
    column = (norm * ((_COLUMNS - 1) / _HIGHEST_NORM)).clamp(0, _COLUMNS - 1)
    i = row.floor().clamp(max=_ROWS - 2)
    j = column.floor().clamp(max=_COLUMNS - 2)
    corner = i.long() * _COLUMNS + j.long()
    across, down = column - j, row - i
    upper = torch.lerp(table[corner], table[corner + 1], across)
    corner = corner + _COLUMNS
    lower = torch.lerp(table[corner], table[corner + 1], across)
    angle = torch.lerp(upper, lower, down) * sigma.clamp(max=HIGHEST_SIGMA)
    return angle.clamp(max=math.pi) / norm.clamp(min=1e-12)


@functools.cache
def _quantile_table(dtype: torch.dtype, device: torch.device) -> Tensor:
    """The quantiles angle / sigma at the nodes, flat (rows * columns,)."""
    return _build_table().to(dtype=dtype, device=device)


@functools.cache
def _build_table() -> Tensor:
    f64 = torch.float64
    sigma = torch.logspace(math.log10(LOWEST_SIGMA), math.log10(HIGHEST_SIGMA), _ROWS, dtype=f64)
    norm = torch.linspace(0, _HIGHEST_NORM, _COLUMNS, dtype=f64)
    density_term = math.sqrt(2 / math.pi) * norm * (-0.5 * norm.square()).exp()
    below = torch.erf(norm / math.sqrt(2)) - density_term
    above = torch.erfc(norm / math.sqrt(2)) + density_term

    reach = (10 * sigma).clamp(max=math.pi)[:, None]
    angle = reach * torch.linspace(0, 1, _QUADRATURE, dtype=f64)
    few = int((sigma < 0.5).sum())
    f = torch.cat(
        [
            small_form(angle[:few], sigma[:few, None]).log_density.exp(),
            series_form(angle[few:], sigma[few:, None], 20).log_density.exp(),
        ]
    )
    value = f * (0.5 * angle).sin().square()
    cell = value[:, 1:] + value[:, :-1]
    cell = cell / cell.sum(-1, keepdim=True)
    zero = torch.zeros(_ROWS, 1, dtype=f64)
    cdf = torch.cat([zero, cell.cumsum(-1)], -1)
    survival = torch.cat([cell.flip(-1).cumsum(-1).flip(-1), zero], -1)
    # The cube root makes the distribution function linear in the angle near 0; the survival
    # function keeps the digits of the far tail.
    lower = _interpolate(below.pow(1 / 3), cdf.pow(1 / 3), angle)
    upper = _interpolate(-above, -survival, angle)
    quantile = torch.where(below < 0.5, lower, upper)
    return (quantile / sigma[:, None]).reshape(-1)


def _interpolate(x: Tensor, knots: Tensor, values: Tensor) -> Tensor:
    """Piecewise linear interpolation at x (m,) of values (n, k) over increasing knots (n, k)."""
    targets = x.expand(knots.shape[0], -1).contiguous()
    j = torch.searchsorted(knots.contiguous(), targets).clamp(1, knots.shape[-1] - 1)
    left, right = knots.gather(-1, j - 1), knots.gather(-1, j)
    share = ((targets - left) / (right - left).clamp(min=torch.finfo(knots.dtype).tiny)).clamp(
        0, 1
    )
    return torch.lerp(values.gather(-1, j - 1), values.gather(-1, j), share)

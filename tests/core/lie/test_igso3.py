"""Isotropic Gaussian on SO(3): densities, score, sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import igso3, so3
from megrasp_core.lie.igso3 import Form
from megrasp_core.lie.igso3_quantiles import angle_ratio

SIGMAS = [0.02, 0.06, 0.2, 0.4999, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0]


def _grid(sigma: float, count: int = 4001) -> torch.Tensor:
    return torch.linspace(0, min(math.pi, 12 * sigma), count, dtype=torch.float64)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_density_integrates_to_one(sigma: float) -> None:
    w = _grid(sigma)
    total = torch.trapezoid(igso3.density(w, sigma) * (1 - w.cos()) / math.pi, w)
    assert float(total) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.7, 1.0])
def test_both_forms_agree(sigma: float) -> None:
    # The series has lost its digits near pi at 0.3; compare where it still has them.
    w = torch.linspace(0, 1.5 if sigma < 0.5 else math.pi, 500, dtype=torch.float64)
    tolerance = 1e-7 if sigma <= 0.5 else 1e-11
    for function in (igso3.log_density, igso3.score):
        series, small = function(w, sigma, "series"), function(w, sigma, "small")
        torch.testing.assert_close(series, small, rtol=tolerance, atol=tolerance)


def test_series_matches_the_textbook_sum() -> None:
    w = torch.linspace(0.1, 3.0, 50, dtype=torch.float64)
    for sigma in (0.6, 1.2, 2.0):
        total = torch.zeros_like(w)
        for degree in range(60):
            weight = (2 * degree + 1) * math.exp(-degree * (degree + 1) * sigma**2 / 2)
            total += weight * ((degree + 0.5) * w).sin() / (0.5 * w).sin()
        torch.testing.assert_close(igso3.density(w, sigma), total, rtol=1e-9, atol=1e-12)


def test_auto_is_continuous_and_finite_everywhere() -> None:
    w = torch.tensor([0, 1e-12, 1e-4, 1e-3, 0.5, 1.0, 3.0, math.pi], dtype=torch.float64)
    below, above = igso3.log_density(w, 0.5 - 1e-12), igso3.log_density(w, 0.5)
    torch.testing.assert_close(below, above, rtol=0, atol=1e-7)
    for sigma in (1e-3, 0.01, 0.06, 0.5, 2.0, 10.0):
        assert torch.isfinite(igso3.log_density(w, sigma)).all()
        assert torch.isfinite(igso3.score(w, sigma)).all()
    assert igso3.density(w, 10.0).sub(1).abs().max() < 1e-9
    mixed = torch.tensor([0.1, 0.5, 2.0], dtype=torch.float64)
    grid = igso3.log_density(w[:, None], mixed)
    for i, sigma in enumerate(mixed.tolist()):
        torch.testing.assert_close(grid[:, i], igso3.log_density(w, sigma), rtol=0, atol=1e-12)


@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.49, 0.51, 1.0, 2.0])
@pytest.mark.parametrize("form", ["auto", "small", "series"])
def test_score_is_the_derivative(sigma: float, form: Form) -> None:
    if (form == "series" and sigma < 0.5) or (form == "small" and sigma > 1):
        form = "auto"
    w = torch.linspace(1e-3, min(math.pi - 1e-3, 6 * sigma), 200, dtype=torch.float64)
    # Wide enough that the rounding of the series near pi (1e-7 at sigma 0.5) does not decide.
    step = 1e-3 * sigma
    ahead, behind = (igso3.log_density(w + d, sigma, form) for d in (step, -step))
    numeric = (ahead - behind) / (2 * step)
    torch.testing.assert_close(igso3.score(w, sigma, form), numeric, rtol=1e-5, atol=1e-4 / sigma)
    ends = torch.tensor([0, math.pi], dtype=torch.float64)
    if form != "small" or sigma > 0.4:
        assert igso3.score(ends, max(sigma, 0.5), form).abs().max() < 1e-6


def test_score_is_the_residual_at_low_noise() -> None:
    """Within 2 % for sigma <= 0.5, and no longer above."""

    def worst(sigma: float) -> float:
        w = torch.linspace(0.01, 2.5 * sigma, 300, dtype=torch.float64)
        return float((igso3.score(w, sigma) * sigma**2 / -w - 1).abs().max())

    assert worst(0.06) < 4e-4
    assert worst(0.25) < 0.01
    assert worst(0.5) < 0.03
    assert worst(1.0) > 0.08


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.1, 0.3, 0.5, 0.77, 1.0, 2.0, 3.0, 6.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_sampled_angles_pass_kolmogorov_smirnov(sigma: float, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(11)
    count = 50000
    angles = igso3.sample(torch.full((count,), sigma, dtype=dtype), generator).norm(dim=-1)
    assert angles.min() >= 0 and angles.max() <= math.pi + 1e-6
    w = _grid(sigma, 20001)
    density = igso3.density(w, sigma) * (1 - w.cos()) / math.pi
    cdf = torch.cat([torch.zeros(1, dtype=w.dtype), torch.cumulative_trapezoid(density, w)])
    knots, values = w.numpy(), cdf.numpy()

    def reference(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(x, knots, values)

    result = stats.kstest(angles.double().numpy(), reference)
    assert result.pvalue > 0.01
    # The same test must notice a sigma that is 3 % off.
    if sigma < 2:
        off = stats.kstest(1.03 * angles.double().numpy(), reference)
        assert off.pvalue < 1e-4


def test_quantile_map_is_accurate_between_the_nodes() -> None:
    norm = torch.linspace(0.01, 6, 3000, dtype=torch.float64)
    maxwell = torch.as_tensor(stats.maxwell.cdf(norm.numpy()))
    for sigma in (0.0123, 0.0777, 0.321, 0.654, 1.234, 2.345):
        w = _grid(sigma, 20001)
        density = igso3.density(w, sigma) * (1 - w.cos()) / math.pi
        cdf = torch.cat([torch.zeros(1, dtype=w.dtype), torch.cumulative_trapezoid(density, w)])
        angle = angle_ratio(norm, torch.full_like(norm, sigma)) * norm
        assert (angle.diff() > -1e-14).all() and (angle[:1000].diff() > 0).all()
        at = torch.searchsorted(w, angle).clamp(1, w.numel() - 1)
        share = (angle - w[at - 1]) / (w[at] - w[at - 1])
        mapped = torch.lerp(cdf[at - 1], cdf[at], share)
        assert (mapped - maxwell).abs().max() < 1e-4


def test_sigma_may_differ_by_element_and_axes_are_uniform() -> None:
    generator = torch.Generator().manual_seed(12)
    sigma = torch.tensor([0.05, 0.5, 2.0], dtype=torch.float64).repeat(20000, 1)
    draws = igso3.sample(sigma, generator)
    assert draws.shape == (20000, 3, 3)
    for i, value in enumerate((0.05, 0.5, 2.0)):
        norm = draws[:, i].norm(dim=-1)
        axis = draws[:, i] / norm[:, None]
        assert axis.mean(0).abs().max() < 0.02
        second = axis.T @ axis / len(axis)
        assert (second - torch.eye(3, dtype=torch.float64) / 3).abs().max() < 0.01
        # E[R] = exp(-sigma^2) I: the l = 1 coefficient of the heat kernel.
        mean = so3.exp(draws[:, i]).mean(0)
        expected = math.exp(-(value**2)) * torch.eye(3, dtype=torch.float64)
        assert (mean - expected).abs().max() < 0.015


def test_convolution_adds_variances() -> None:
    """Heat kernels compose: sigma 0.6 after sigma 0.8 is sigma 1.0."""
    generator = torch.Generator().manual_seed(13)
    first = so3.exp(igso3.sample(torch.full((40000,), 0.6, dtype=torch.float64), generator))
    second = so3.exp(igso3.sample(torch.full((40000,), 0.8, dtype=torch.float64), generator))
    drawn = igso3.sample(torch.full((40000,), 1.0, dtype=torch.float64), generator)
    direct = drawn.norm(dim=-1)
    composed = so3.angle(first @ second)
    assert stats.ks_2samp(composed.numpy(), direct.numpy()).pvalue > 0.01


def test_same_generator_state_same_draws_and_bad_form_is_named() -> None:
    sigma = torch.full((100,), 0.4)
    one = igso3.sample(sigma, torch.Generator().manual_seed(5))
    two = igso3.sample(sigma, torch.Generator().manual_seed(5))
    assert torch.equal(one, two) and one.dtype == torch.float32
    with pytest.raises(InvalidRequestError, match="form"):
        igso3.density(sigma, 0.5, "exact")  # pyright: ignore[reportArgumentType]

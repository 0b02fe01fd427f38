"""Noise schedule and forward process: ranges, inverses, scores, exact denoiser."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from point_mixture import PointMixture
from torch import Tensor

from megrasp_core.diffusion import (
    LOW_LEVEL,
    NoiseSchedule,
    perturb,
    score_target,
    target,
)
from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import PoseBatch, full_precision, igso3, so3

F64 = torch.float64


@full_precision
def _applied(residual: Tensor, poses: PoseBatch, s: Tensor, schedule: NoiseSchedule) -> PoseBatch:
    """Clean poses that a residual (..., 6) at the noisy ones means; undoes `target`."""
    offset = (schedule.sigma_t * s)[..., None] * residual[..., :3]
    turn = (schedule.sigma_r * s)[..., None] * residual[..., 3:]
    moved = poses.translation + (poses.rotation @ offset[..., None]).squeeze(-1)
    return PoseBatch(poses.rotation @ so3.exp(turn), moved)


def _poses(count: int, seed: int) -> tuple[PoseBatch, torch.Generator]:
    generator = torch.Generator().manual_seed(seed)
    rotation = so3.random_rotation(count, generator=generator, dtype=F64)
    place = 0.3 * torch.randn(count, 3, generator=generator, dtype=F64)
    return PoseBatch(rotation, place), generator


def test_levels_of_the_design() -> None:
    levels = NoiseSchedule().levels(10)
    assert len(levels) == 11 and levels[0] == 1 and levels[-1] == 0
    assert levels[9] == pytest.approx(0.03)
    ratios = [b / a for a, b in itertools.pairwise(levels[:10])]
    assert ratios == pytest.approx([0.03 ** (1 / 9)] * 9)
    restart = NoiseSchedule().levels(5, 0.3)
    assert restart == pytest.approx([0.3 * 0.1 ** (k / 4) for k in range(5)] + [0])
    assert NoiseSchedule().levels(1) == [1.0, 0.0]


def test_random_levels_are_even_in_their_logarithm() -> None:
    generator = torch.Generator().manual_seed(0)
    s = NoiseSchedule().random_levels(20000, generator)
    assert s.min() >= 0.03 - 1e-6 and s.max() <= 1
    assert s.log().mean() == pytest.approx(math.log(0.03) / 2, abs=0.03)


@pytest.mark.parametrize("s_min", [0.015, 0.03])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_levels_is_low(s_min: float, share: float) -> None:
    s = NoiseSchedule(s_min=s_min).random_levels(
        2000, torch.Generator().manual_seed(1), low_share=share
    )
    assert float((s < LOW_LEVEL).float().mean()) == pytest.approx(share, abs=2e-3)
    assert s.min() >= s_min - 1e-6 and s.max() <= 1
    low = s[s < LOW_LEVEL].log()
    if share:
        assert low.mean() == pytest.approx(math.log(s_min * LOW_LEVEL) / 2, abs=0.05)


@pytest.mark.parametrize("values", [{"sigma_t": 0.0}, {"sigma_r": -1.0}, {"s_min": 1.0}])
def test_bad_schedule_is_named(values: dict) -> None:
    with pytest.raises(InvalidRequestError, match="expected"):
        NoiseSchedule(**values)
    with pytest.raises(InvalidRequestError, match="expected"):
        NoiseSchedule().levels(0)
    with pytest.raises(InvalidRequestError, match="expected"):
        NoiseSchedule().levels(5, 0.02)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.03, 0.3, 1]))
def test_target_leads_back_exactly(seed: int, level: float) -> None:
    schedule = NoiseSchedule()
    poses, generator = _poses(20, seed)
    s = torch.full((20,), float(level), dtype=F64)
    noisy = perturb(poses, s, schedule, generator)
    back = _applied(target(poses, noisy, s, schedule), noisy, s, schedule)
    torch.testing.assert_close(back.rotation, poses.rotation, rtol=0, atol=1e-13)
    torch.testing.assert_close(back.translation, poses.translation, rtol=0, atol=1e-13)


def test_target_has_unit_size_at_every_level() -> None:
    poses, generator = _poses(20000, 1)
    schedule = NoiseSchedule()
    for level in (0.03, 0.1, 0.25):
        s = torch.full((20000,), level, dtype=F64)
        noisy = perturb(poses, s, schedule, generator)
        y = target(poses, noisy, s, schedule)
        assert y[:, :3].square().mean() == pytest.approx(1, abs=0.03)
        assert y[:, 3:].square().mean() == pytest.approx(1, abs=0.03)
        assert y.mean(0).abs().max() < 0.03


def test_top_level_is_a_uniform_rotation() -> None:
    """Sigma 2.0: E[R_0^T R_1] = exp(-4) I, so Haar is a correct start."""
    poses, generator = _poses(40000, 2)
    noisy = perturb(poses, torch.ones(40000, dtype=F64), NoiseSchedule(), generator)
    mean = (poses.rotation.mT @ noisy.rotation).mean(0)
    assert (mean - math.exp(-4) * torch.eye(3, dtype=F64)).abs().max() < 0.012


def test_noise_and_target_are_equivariant() -> None:
    poses, _ = _poses(50, 3)
    q = so3.random_rotation(generator=torch.Generator().manual_seed(9), dtype=F64)
    u = torch.tensor([0.4, -0.1, 0.7], dtype=F64)
    s = torch.linspace(0.03, 1, 50, dtype=F64)
    schedule = NoiseSchedule()
    plain = perturb(poses, s, schedule, torch.Generator().manual_seed(4))
    start = PoseBatch(q @ poses.rotation, poses.translation @ q.T + u)
    moved = perturb(start, s, schedule, torch.Generator().manual_seed(4))
    torch.testing.assert_close(moved.rotation, q @ plain.rotation, rtol=0, atol=1e-14)
    shifted = plain.translation @ q.T + u
    torch.testing.assert_close(moved.translation, shifted, rtol=0, atol=1e-14)
    torch.testing.assert_close(
        target(start, moved, s, schedule),
        target(poses, plain, s, schedule),
        rtol=0,
        atol=1e-11,
    )


@pytest.mark.parametrize("level", [0.03, 0.2, 0.25, 0.6, 1.0])
def test_score_target_is_the_gradient_of_the_log_density(level: float) -> None:
    poses, generator = _poses(40, 5)
    schedule = NoiseSchedule()
    s = torch.full((40,), level, dtype=F64)
    noisy = perturb(poses, s, schedule, generator)
    score = score_target(poses, noisy, s, schedule)
    relative = poses.rotation.mT @ noisy.rotation
    sigma = level * schedule.sigma_r
    step = 1e-5 * sigma
    for axis in range(3):
        turn = torch.zeros(3, dtype=F64)
        turn[axis] = step
        ahead, behind = (
            igso3.log_density(so3.angle(relative @ so3.exp(d)), sigma) for d in (turn, -turn)
        )
        numeric = sigma * (ahead - behind) / (2 * step)
        torch.testing.assert_close(score[:, axis], numeric, rtol=1e-4, atol=1e-5)
    identity = score_target(poses, poses, s, schedule)
    assert torch.isfinite(identity).all() and identity.abs().max() < 1e-5


def test_training_quantities_are_differentiable_where_nothing_moved() -> None:
    poses, _ = _poses(3, 6)
    poses.translation.requires_grad_()
    w = torch.zeros(3, 3, dtype=F64, requires_grad=True)
    s = torch.full((3,), 0.5, dtype=F64)
    turned = PoseBatch(poses.rotation @ so3.exp(w), poses.translation.detach())
    target(poses, turned, s, NoiseSchedule()).sum().backward()
    assert w.grad is not None and torch.isfinite(w.grad).all()
    torch.testing.assert_close(w.grad, torch.full_like(w, -1.0))


def test_exact_denoiser_minimises_the_training_loss() -> None:
    """Monte Carlo: the closed-form mean beats any perturbed version of itself."""
    generator = torch.Generator().manual_seed(7)
    schedule = NoiseSchedule()
    modes = so3.random_rotation(2, generator=generator, dtype=F64)
    places = torch.tensor([[0, 0, 0], [0.1, 0, 0]], dtype=F64)
    both = PoseBatch(modes, places)
    mixture = PointMixture(both, torch.tensor([0.8, 0.2], dtype=F64), schedule)
    count = 20000
    k = torch.multinomial(mixture.weight, count, True, generator=generator)
    s = torch.full((count,), 0.5, dtype=F64)
    noisy = perturb(both.part(k), s, schedule, generator)
    y = target(both.part(k), noisy, s, schedule)
    mean = mixture.residual(noisy, s)
    best = (mean - y).square().mean()
    right = (mixture.posterior(noisy, s).argmax(-1) == k).double().mean()
    assert 0.85 < right < 0.99, "the modes should overlap a little"
    for factor in (0.9, 1.1):
        assert (factor * mean - y).square().mean() > best
    swapped = PointMixture(both, torch.tensor([0.5, 0.5], dtype=F64), schedule)
    assert (swapped.residual(noisy, s) - y).square().mean() > best
    # Calibration: the posterior's mean is the share of each mode.
    share = mixture.posterior(noisy, s).mean(0)
    assert share[0] == pytest.approx(0.8, abs=0.01)
    # The conditional mean of the score target is the mixture's score.
    regress = score_target(both.part(k), noisy, s, schedule)
    exact = mixture.scaled_score(noisy, s)[:, 3:]
    assert (regress - exact).mean(0).abs().max() < 0.02
    assert (exact * (regress - exact)).sum(-1).mean().abs() < 0.02


def test_autocast_does_not_touch_poses() -> None:
    generator = torch.Generator().manual_seed(8)
    rotation = so3.random_rotation(10, generator=generator)
    poses = PoseBatch(rotation, torch.randn(10, 3, generator=generator))
    s = torch.full((10,), 0.3)
    schedule = NoiseSchedule()

    def everything() -> list[torch.Tensor]:
        noisy = perturb(poses, s, schedule, torch.Generator().manual_seed(1))
        y = target(poses, noisy, s, schedule)
        back = _applied(y, noisy, s, schedule)
        score = score_target(poses, noisy, s, schedule)
        return [noisy.rotation, noisy.translation, y, score, back.rotation, back.translation]

    with torch.autocast("cpu", dtype=torch.bfloat16):
        under = everything()
    for a, b in zip(under, everything(), strict=True):
        assert torch.equal(a, b)

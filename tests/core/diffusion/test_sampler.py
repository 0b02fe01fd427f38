"""Samplers with exact denoisers: convergence, counts, equivariance, cancelling, mode shares."""

from __future__ import annotations

import math

import pytest
import torch
from point_mixture import PointMixture

from megrasp_core.diffusion import (
    NoiseSchedule,
    SamplerSettings,
    SamplerStep,
    descend,
    last_step,
    refine,
    sample_steps,
    target,
)
from megrasp_core.errors import CancelledError, InvalidRequestError
from megrasp_core.lie import PoseBatch, so3

F64 = torch.float64


def _single(count: int, schedule: NoiseSchedule):
    """A denoiser that knows the one clean pose."""
    generator = torch.Generator().manual_seed(1)
    rotation = so3.random_rotation(1, generator=generator, dtype=F64)
    translation = torch.tensor([[0.1, -0.2, 0.05]], dtype=F64)

    def denoise(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        clean = PoseBatch(
            rotation.expand_as(poses.rotation), translation.expand_as(poses.translation)
        )
        return target(clean, poses, s, schedule)

    starts = translation + 0.1 * torch.randn(count, 3, generator=generator, dtype=F64)
    return denoise, rotation, translation, starts, generator


@pytest.mark.parametrize("kind", ["deterministic", "ancestral"])
@pytest.mark.parametrize("restarts", [0, 2])
def test_one_target_is_reached(kind, restarts: int) -> None:
    schedule = NoiseSchedule()
    denoise, rotation, translation, starts, generator = _single(200, schedule)
    choice = SamplerSettings(kind=kind, restarts=restarts)
    last = last_step(sample_steps(denoise, starts, choice, schedule, generator))
    assert last.s == 0 and last.index == last.total == 10 + 5 * restarts
    torch.testing.assert_close(
        last.poses.translation, translation.expand(200, 3), rtol=0, atol=1e-12
    )
    torch.testing.assert_close(last.poses.rotation, rotation.expand(200, 3, 3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["langevin", "probability_flow"])
def test_score_samplers_reach_one_target(kind) -> None:
    schedule = NoiseSchedule()
    _, rotation, translation, starts, generator = _single(100, schedule)
    mixture = PointMixture(PoseBatch(rotation, translation), torch.ones(1, dtype=F64), schedule)
    choice = SamplerSettings(kind=kind, steps=20, restarts=0, langevin_inner=5)
    assert choice.uses_score
    last = last_step(sample_steps(mixture.scaled_score, starts, choice, schedule, generator))
    torch.testing.assert_close(
        last.poses.translation, translation.expand(100, 3), rtol=0, atol=1e-9
    )
    # The last evaluation takes the score for the residual: exact to sigma^2/12 of 0.06 rad.
    assert so3.angle(rotation.mT @ last.poses.rotation).max() < 1e-3


def test_default_counts_twenty_evaluations_at_the_grid_of_the_design() -> None:
    schedule, choice = NoiseSchedule(), SamplerSettings()
    denoise, _, _, starts, generator = _single(3, schedule)
    seen: list[float] = []

    def counting(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        assert s.shape == (3,) and poses.rotation.shape == (3, 3, 3)
        seen.append(float(s[0]))
        return denoise(poses, s)

    steps = list(sample_steps(counting, starts, choice, schedule, generator))
    grid = [0.03 ** (k / 9) for k in range(10)]
    restart = [0.3 * 0.1 ** (k / 4) for k in range(5)]
    assert seen == pytest.approx(grid + restart + restart)
    assert [step.index for step in steps] == list(range(1, 21))
    assert {step.total for step in steps} == {20} and choice.evaluations == 20
    assert [step.s for step in steps] == pytest.approx(
        [*grid[1:], 0, *restart[1:], 0, *restart[1:], 0]
    )
    for settings, expected in (
        (SamplerSettings(kind="langevin", restarts=0), 200),
        (SamplerSettings(kind="langevin", restarts=0, langevin_predictor=False), 201),
        (SamplerSettings(kind="langevin", steps=2, restarts=1, langevin_inner=3), 6 + 15),
    ):
        made = list(sample_steps(denoise, starts, settings, schedule, generator))
        assert len(made) == settings.evaluations == expected and made[-1].s == 0


def test_noise_between_steps_has_the_level_that_is_announced() -> None:
    """After an ancestral step to s' the poses are distributed as the target with noise s'."""
    schedule = NoiseSchedule()
    denoise, rotation, translation, _, generator = _single(1, schedule)
    count = 20000
    starts = translation.expand(count, 3)
    choice = SamplerSettings(restarts=0)
    checked = 0
    for step in descend(denoise, starts, choice, schedule, generator):
        if 0 < step.s < 0.3:
            offset = (step.poses.translation - translation) / (step.s * schedule.sigma_t)
            turn = so3.log(rotation.mT @ step.poses.rotation) / (step.s * schedule.sigma_r)
            assert offset.square().mean() == pytest.approx(1, abs=0.04)
            # Bridges on SO(3) are Gaussian only for small angles.
            allowed = 0.03 if step.s < 0.08 else 0.1
            assert turn.square().mean() == pytest.approx(1, abs=allowed), step.s
            checked += 1
    assert checked == 6


def test_descend_then_a_subset_then_refine() -> None:
    schedule, choice = NoiseSchedule(), SamplerSettings()
    denoise, rotation, _, starts, generator = _single(50, schedule)
    first = last_step(descend(denoise, starts, choice, schedule, generator))
    assert first.total == choice.descend_evaluations == 10 and len(first.poses) == 50
    keep = torch.arange(0, 50, 5)
    steps = list(refine(denoise, first.poses.part(keep), choice, schedule, generator))
    assert len(steps) == choice.refine_evaluations == 10
    assert all(step.poses.rotation.shape == (10, 3, 3) for step in steps)
    # The first restart really left the poses.
    assert so3.angle(rotation.mT @ steps[0].poses.rotation).mean() > 0.05
    assert so3.angle(rotation.mT @ steps[-1].poses.rotation).max() < 1e-10


def test_cancelling_stops_within_one_step() -> None:
    schedule, choice = NoiseSchedule(), SamplerSettings()
    denoise, _, _, starts, generator = _single(4, schedule)
    calls: list[float] = []

    def counting(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        calls.append(float(s[0]))
        return denoise(poses, s)

    progress: list[SamplerStep] = []
    with pytest.raises(CancelledError, match="step 3 of 20"):
        last_step(
            sample_steps(counting, starts, choice, schedule, generator),
            on_step=progress.append,
            cancelled=lambda: len(calls) >= 3,
        )
    assert len(calls) == len(progress) == 3
    # An iterator nobody asks computes nothing.
    steps = sample_steps(counting, starts, choice, schedule, generator)
    next(steps)
    assert len(calls) == 4


def test_same_generator_same_samples_and_global_state_is_untouched() -> None:
    schedule, choice = NoiseSchedule(), SamplerSettings()
    denoise, _, _, starts, _ = _single(8, schedule)
    state = torch.get_rng_state()
    runs = []
    for seed in (3, 3, 4):
        generator = torch.Generator().manual_seed(seed)
        runs.append(list(descend(denoise, starts, choice, schedule, generator))[3])
    assert torch.equal(runs[0].poses.rotation, runs[1].poses.rotation)
    assert not torch.equal(runs[0].poses.rotation, runs[2].poses.rotation)
    assert torch.equal(state, torch.get_rng_state())


@pytest.mark.parametrize("kind", ["ancestral", "deterministic"])
def test_samples_move_with_the_world(kind) -> None:
    """Equivariant denoiser, moved starts, equal generator state: moved samples."""
    schedule, choice = NoiseSchedule(), SamplerSettings(kind=kind)
    generator = torch.Generator().manual_seed(8)
    modes = so3.random_rotation(3, generator=generator, dtype=F64)
    places = 0.1 * torch.randn(3, 3, generator=generator, dtype=F64)
    weight = torch.full((3,), 1 / 3, dtype=F64)
    q = so3.random_rotation(generator=generator, dtype=F64)
    u = torch.tensor([0.5, 0.2, -0.3], dtype=F64)
    start_r = so3.random_rotation(30, generator=generator, dtype=F64)
    start_t = 0.1 * torch.randn(30, 3, generator=generator, dtype=F64)
    ends = []
    for turn, shift in ((torch.eye(3, dtype=F64), torch.zeros(3, dtype=F64)), (q, u)):
        mixture = PointMixture(PoseBatch(turn @ modes, places @ turn.T + shift), weight, schedule)
        steps = descend(
            mixture.residual,
            start_t @ turn.T + shift,
            choice,
            schedule,
            torch.Generator().manual_seed(2),
            rotation=turn @ start_r,
        )
        ends.append(list(steps)[6])
    torch.testing.assert_close(
        ends[1].poses.rotation, q @ ends[0].poses.rotation, rtol=0, atol=1e-9
    )
    torch.testing.assert_close(
        ends[1].poses.translation, ends[0].poses.translation @ q.T + u, rtol=0, atol=1e-9
    )


def test_rotations_stay_on_the_group_in_float32() -> None:
    schedule = NoiseSchedule()
    generator = torch.Generator().manual_seed(5)

    def noise(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        return torch.randn(len(poses), 6, generator=generator)

    choice = SamplerSettings(steps=500, restarts=20, restart_steps=25)
    last = last_step(sample_steps(noise, torch.zeros(64, 3), choice, schedule, generator))
    assert last.total == 1000 and last.poses.rotation.dtype == torch.float32
    error = last.poses.rotation.mT @ last.poses.rotation - torch.eye(3)
    assert error.abs().max() < 1e-6


def test_no_gradient_is_recorded_and_low_precision_residuals_are_taken() -> None:
    schedule = NoiseSchedule()
    weight = torch.ones(6, requires_grad=True)

    def denoise(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        return (weight * s[:, None]).bfloat16()

    last = last_step(sample_steps(denoise, torch.zeros(4, 3), SamplerSettings(), schedule))
    assert not last.poses.rotation.requires_grad and last.poses.translation.dtype == torch.float32
    assert torch.is_grad_enabled()


def test_autocast_around_the_sampler_does_not_touch_poses() -> None:
    schedule = NoiseSchedule()
    ends = []
    for enabled in (False, True):
        generator = torch.Generator().manual_seed(3)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            steps = sample_steps(
                lambda poses, s: torch.full((5, 6), 0.3),
                torch.ones(5, 3),
                SamplerSettings(),
                schedule,
                generator,
            )
            ends.append(last_step(steps))
    assert torch.equal(ends[0].poses.rotation, ends[1].poses.rotation)
    assert torch.equal(ends[0].poses.translation, ends[1].poses.translation)


@pytest.mark.parametrize(
    "values",
    [
        {"kind": "euler"},
        {"steps": 0},
        {"restarts": -1},
        {"restart_level": 0.0},
        {"langevin_step": 2.0},
        {"restart_level": 0.02},
    ],
)
def test_bad_settings_are_named(values: dict) -> None:
    with pytest.raises(InvalidRequestError, match="expected"):
        SamplerSettings(**values).check(NoiseSchedule())


def test_bad_starts_are_named_before_the_first_step() -> None:
    schedule, choice = NoiseSchedule(), SamplerSettings()
    denoise, *_ = _single(1, schedule)
    with pytest.raises(InvalidRequestError, match="starts"):
        descend(denoise, torch.zeros(3), choice, schedule)
    with pytest.raises(InvalidRequestError, match="expected"):
        refine(denoise, PoseBatch(torch.zeros(2, 3), torch.zeros(2, 3)), choice, schedule)
    with pytest.raises(InvalidRequestError, match="without steps"):
        last_step(
            refine(
                denoise,
                PoseBatch(torch.eye(3).expand(2, 3, 3), torch.zeros(2, 3)),
                SamplerSettings(restarts=0),
                schedule,
            )
        )


def _share(settings: SamplerSettings, count: int) -> float:
    """Share of the heavy one of two modes (0.8/0.2) half a turn apart, exact denoiser."""
    schedule = NoiseSchedule()
    half_turn = so3.exp(torch.tensor([0, 0, math.pi]))
    mixture = PointMixture(
        PoseBatch(torch.stack([torch.eye(3), half_turn]), torch.zeros(2, 3)),
        torch.tensor([0.8, 0.2]),
        schedule,
    )
    denoise = mixture.scaled_score if settings.uses_score else mixture.residual
    generator = torch.Generator().manual_seed(1)
    steps = sample_steps(denoise, torch.zeros(count, 3), settings, schedule, generator)
    last = last_step(steps)
    mode = mixture.nearest(last.poses)
    turn = so3.angle(mixture.poses.rotation[mode].mT @ last.poses.rotation)
    assert turn.max() < 0.01, "a sample between the modes"
    return float((mode == 0).float().mean())


def test_residual_samplers_favour_the_heavy_mode(record_property) -> None:
    """The known bias of E[y|r] above s sigma_r = 0.5: 0.8 comes out about 0.88."""
    share = _share(SamplerSettings(), 4000)
    record_property("ancestral_10_2x5_heavy_share", share)
    assert share == pytest.approx(0.88, abs=0.02)
    deterministic = _share(SamplerSettings(kind="deterministic", restarts=0), 4000)
    record_property("deterministic_heavy_share", deterministic)
    assert deterministic > share


def test_score_head_recovers_the_shares(record_property) -> None:
    langevin = _share(SamplerSettings(kind="langevin", restarts=0), 1500)
    flow = _share(SamplerSettings(kind="probability_flow", steps=50, restarts=0), 2000)
    record_property("langevin_heavy_share", langevin)
    record_property("probability_flow_heavy_share", flow)
    assert langevin == pytest.approx(0.80, abs=0.03)
    assert flow == pytest.approx(0.80, abs=0.03)

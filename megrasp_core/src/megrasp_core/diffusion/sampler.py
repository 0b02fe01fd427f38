"""Samplers on SE(3): from noise to grasp poses in a few evaluations of a denoiser.

A sampler is an iterator over steps. It computes nothing between two requests, so a caller cancels
by no longer asking, keeps only the best poses between `descend` and `refine`, and reports
progress. All randomness comes from the generator that is passed. Noise is drawn in the frame of
the pose: with equal generator states the samples turn and move with the starts. See
docs/architecture.md, "Diffusion".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from megrasp_core.errors import CancelledError, InvalidRequestError
from megrasp_core.lie import PoseBatch, full_precision, igso3, so3

from .forward import perturb
from .schedule import NoiseSchedule
from .settings import SamplerSettings

Denoise = Callable[[PoseBatch, Tensor], Tensor]
"""(P poses, levels (P,)) -> (P, 6): the residual; where `SamplerSettings.uses_score`, its last
three numbers are the rotation score head's instead."""


@dataclass(frozen=True)
class SamplerStep:
    """State after one evaluation of the network.

    Attributes:
        index: evaluations done so far, from 1.
        total: evaluations of the iterator this step comes from.
        s: noise level of these poses; 0.0 once they are samples.
        poses: P of them.
    """

    index: int
    total: int
    s: float
    poses: PoseBatch


def sample_steps(
    denoise: Denoise,
    starts: Tensor,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None = None,
) -> Iterator[SamplerStep]:
    """All evaluations: the descent from noise and the restarts; see `descend` and `refine`."""
    total = settings.evaluations
    last: SamplerStep | None = None
    for step in descend(denoise, starts, settings, schedule, generator):
        last = replace(step, total=total)
        yield last
    assert last is not None
    done = last.index
    for step in refine(denoise, last.poses, settings, schedule, generator):
        yield replace(step, index=done + step.index, total=total)


def descend(
    denoise: Denoise,
    starts: Tensor,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None = None,
    rotation: Tensor | None = None,
) -> Iterator[SamplerStep]:
    """From noise at s = 1 to poses at s = 0.

    Args:
        denoise: see `Denoise`.
        starts: (P, 3) points (m), for example scene nodes. The sampler adds the noise of s = 1 to
            them and draws uniform rotations.
        settings: the sampler.
        schedule: the noise that the network was trained with.
        generator: on the device of `starts`.
        rotation: (P, 3, 3) starting rotations; with them `starts` are taken as they are, noise
            included.

    Raises:
        InvalidRequestError: wrong shapes, a generator of another device, or settings that do not
            fit the schedule.
    """
    if starts.ndim != 2 or starts.shape[-1] != 3:
        raise InvalidRequestError(f"got starts of shape {tuple(starts.shape)}; expected (P, 3)")
    _check(starts, settings, schedule, generator)
    poses = (
        _draw_starts(starts, schedule, generator)
        if rotation is None
        else PoseBatch(rotation, starts)
    )
    return _walk(
        denoise,
        poses,
        settings,
        schedule,
        generator,
        [1.0],
        settings.steps,
        settings.descend_evaluations,
    )


def refine(
    denoise: Denoise,
    poses: PoseBatch,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None = None,
) -> Iterator[SamplerStep]:
    """Restarts: noise of s = restart_level on finished poses, down again; `restarts` times.

    Args:
        denoise: see `Denoise`; may be built for these poses only.
        poses: P poses at s = 0, a part of the descent's or all.
        settings: the sampler.
        schedule: the noise that the network was trained with.
        generator: on the device of the poses.

    Raises:
        InvalidRequestError: as for `descend`.
    """
    rotation, place = poses.rotation, poses.translation
    if place.ndim != 2 or rotation.shape != (*place.shape, 3):
        raise InvalidRequestError(
            f"got rotations {tuple(rotation.shape)} and translations {tuple(place.shape)}; "
            "expected (P, 3, 3) and (P, 3)"
        )
    _check(place, settings, schedule, generator)
    return _walk(
        denoise,
        poses,
        settings,
        schedule,
        generator,
        [settings.restart_level] * settings.restarts,
        settings.restart_steps,
        settings.refine_evaluations,
        noise_first=True,
    )


def last_step(
    steps: Iterator[SamplerStep],
    on_step: Callable[[SamplerStep], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> SamplerStep:
    """Run an iterator of steps to its end and return the last one.

    Raises:
        CancelledError: `cancelled` returned true between two steps.
        InvalidRequestError: the iterator has no step (restarts = 0).
    """
    step: SamplerStep | None = None
    for step in steps:
        if on_step is not None:
            on_step(step)
        if step.index < step.total and cancelled is not None and cancelled():
            raise CancelledError(f"cancelled after step {step.index} of {step.total}")
    if step is None:
        raise InvalidRequestError("got a sampler without steps; expected at least one")
    return step


def _check(
    poses: Tensor,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None,
) -> None:
    settings.check(schedule)
    if generator is not None and generator.device.type != poses.device.type:
        raise InvalidRequestError(
            f"got a generator on {generator.device} for poses on {poses.device}; expected one on "
            f"the same device: torch.Generator({str(poses.device)!r})"
        )


def _draw_starts(
    starts: Tensor, schedule: NoiseSchedule, generator: torch.Generator | None
) -> PoseBatch:
    rotation = so3.random_rotation(
        starts.shape[0], generator=generator, dtype=starts.dtype, device=starts.device
    )
    noise = torch.randn(
        starts.shape, generator=generator, dtype=starts.dtype, device=starts.device
    )
    return PoseBatch(rotation, starts + schedule.sigma_t * noise)


@torch.no_grad()
def _walk(
    denoise: Denoise,
    poses: PoseBatch,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None,
    tops: list[float],
    steps: int,
    total: int,
    noise_first: bool = False,
) -> Iterator[SamplerStep]:
    """Descents from the levels `tops`, each over `steps` levels, one yield per evaluation."""
    index = 0
    count = (len(poses),)
    for top in tops:
        if noise_first:
            level = poses.translation.new_full(count, top)
            poses = perturb(poses, level, schedule, generator)
        moves = list(_plan(settings, schedule, steps, top))
        noise = _noise([move.noise for move in moves], poses.translation, schedule, generator)
        for k, move in enumerate(moves):
            residual = denoise(poses, poses.translation.new_full(count, move.s))
            kick = None if noise is None else (noise[0][k], noise[1][k])
            poses = _moved(poses, residual, move.amount, kick, schedule)
            index += 1
            yield SamplerStep(index, total, move.after, poses)


class _Move(NamedTuple):
    """One evaluation, all in levels: where, how far to follow it, noise to add, where it ends."""

    s: float
    amount: float
    noise: float
    after: float


def _plan(
    settings: SamplerSettings, schedule: NoiseSchedule, steps: int, top: float
) -> Iterator[_Move]:
    levels = schedule.levels(steps, top)
    predictor = settings.kind == "ancestral" or settings.langevin_predictor
    corrections = settings.langevin_inner - int(settings.langevin_predictor)
    step = settings.langevin_step
    for s, after in itertools.pairwise(levels):
        if settings.kind not in ("ancestral", "langevin"):
            yield _Move(s, s - after, 0.0, after)
            continue
        if settings.kind == "langevin":
            for _ in range(corrections):
                yield _Move(s, 0.5 * step * s, math.sqrt(step) * s, s)
        if predictor:
            removed = 1 - (after / s) ** 2
            yield _Move(s, s * removed, after * math.sqrt(removed), after)
    if settings.kind == "langevin" and not predictor:
        yield _Move(levels[-2], levels[-2], 0.0, 0.0)


def _noise(
    levels: list[float],
    like: Tensor,
    schedule: NoiseSchedule,
    generator: torch.Generator | None,
) -> tuple[Tensor, Tensor] | None:
    """Offsets (K, P, 3) and turns (K, P, 3, 3) for K moves, drawn at once, which is cheaper."""
    if not any(levels):
        return None
    level = torch.tensor(levels, dtype=like.dtype, device=like.device)[:, None]
    level = level.expand(-1, like.shape[0])
    eps = torch.randn(*level.shape, 3, generator=generator, dtype=like.dtype, device=like.device)
    turn = so3.exp(igso3.sample(schedule.sigma_r * level, generator))
    return (schedule.sigma_t * level)[..., None] * eps, turn


@full_precision
def _moved(
    poses: PoseBatch,
    residual: Tensor,
    amount: float,
    noise: tuple[Tensor, Tensor] | None,
    schedule: NoiseSchedule,
) -> PoseBatch:
    """Poses after going `amount` (in levels) along the residual (P, 6) and taking the noise."""
    rotation, place = poses.rotation, poses.translation
    residual = residual.to(place.dtype)
    offset = (amount * schedule.sigma_t) * residual[:, :3]
    turned = rotation @ so3.exp((amount * schedule.sigma_r) * residual[:, 3:])
    if noise is not None:
        offset = offset + noise[0]
        turned = turned @ noise[1]
    moved = place + (rotation @ offset[..., None]).squeeze(-1)
    return PoseBatch(so3.orthonormalize(turned), moved)

"""Samplers on SE(3): from noise to grasp poses in a few evaluations of a denoiser.

A sampler is an iterator over steps. It computes nothing between two requests, so a caller cancels
by no longer asking, keeps only the best poses between `descend` and `refine`, and reports
progress. All randomness comes from the generator that is passed. Noise is drawn in the frame of
the pose: with equal generator states the samples turn and move with the starts. DESIGN section 6.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from megrasp_core.diffusion.forward import perturb
from megrasp_core.diffusion.schedule import NoiseSchedule
from megrasp_core.diffusion.settings import SamplerSettings
from megrasp_core.errors import CancelledError, InvalidRequestError
from megrasp_core.lie import igso3, so3

Denoise = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(R (P, 3, 3), t (P, 3), s (P,)) -> (P, 6): the residual; where `SamplerSettings.uses_score`, its
last three numbers are the rotation score head's instead."""


@dataclass(frozen=True)
class SamplerStep:
    """State after one evaluation of the network.

    Attributes:
        index: evaluations done so far, from 1.
        total: evaluations of the iterator this step comes from.
        s: noise level of these poses; 0.0 once they are samples.
        rotation: (P, 3, 3).
        translation: (P, 3), metres.
    """

    index: int
    total: int
    s: float
    rotation: Tensor
    translation: Tensor


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
        last = SamplerStep(step.index, total, step.s, step.rotation, step.translation)
        yield last
    assert last is not None
    done = last.index
    for step in refine(denoise, last.rotation, last.translation, settings, schedule, generator):
        yield SamplerStep(done + step.index, total, step.s, step.rotation, step.translation)


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
    if rotation is None:
        rotation, starts = _draw_starts(starts, schedule, generator)
    return _walk(
        denoise,
        rotation,
        starts,
        settings,
        schedule,
        generator,
        [1.0],
        settings.steps,
        settings.descend_evaluations,
    )


def refine(
    denoise: Denoise,
    rotation: Tensor,
    translation: Tensor,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None = None,
) -> Iterator[SamplerStep]:
    """Restarts: noise of s = restart_level on finished poses, down again; `restarts` times.

    Args:
        denoise: see `Denoise`; may be built for these poses only.
        rotation: (P, 3, 3) poses at s = 0, a subset of the descent's or all.
        translation: (P, 3), metres.
        settings: the sampler.
        schedule: the noise that the network was trained with.
        generator: on the device of the poses.

    Raises:
        InvalidRequestError: as for `descend`.
    """
    if translation.ndim != 2 or rotation.shape != (*translation.shape, 3):
        raise InvalidRequestError(
            f"got rotations {tuple(rotation.shape)} and translations {tuple(translation.shape)}; "
            "expected (P, 3, 3) and (P, 3)"
        )
    _check(translation, settings, schedule, generator)
    return _walk(
        denoise,
        rotation,
        translation,
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
) -> tuple[Tensor, Tensor]:
    rotation = so3.random_rotation(
        starts.shape[0], generator=generator, dtype=starts.dtype, device=starts.device
    )
    noise = torch.randn(
        starts.shape, generator=generator, dtype=starts.dtype, device=starts.device
    )
    return rotation, starts + schedule.sigma_t * noise


@torch.no_grad()
def _walk(
    denoise: Denoise,
    rotation: Tensor,
    translation: Tensor,
    settings: SamplerSettings,
    schedule: NoiseSchedule,
    generator: torch.Generator | None,
    tops: list[float],
    steps: int,
    total: int,
    noise_first: bool = False,
) -> Iterator[SamplerStep]:
    """Descents from the levels `tops`, each over `steps` levels, one yield per evaluation."""
    pose = _Pose(rotation, translation, schedule, generator)
    index = 0
    for top in tops:
        if noise_first:
            pose.add_noise(top)
        for s, share, noise, after in _plan(settings, schedule, steps, top):
            residual = denoise(pose.rotation, pose.translation, pose.level(s))
            pose.move(residual, s * share, noise)
            index += 1
            yield SamplerStep(index, total, after, pose.rotation, pose.translation)


def _plan(
    settings: SamplerSettings, schedule: NoiseSchedule, steps: int, top: float
) -> Iterator[tuple[float, float, float, float]]:
    """(level, share of the residual, noise level to add, level afterwards) per evaluation."""
    levels = schedule.levels(steps, top)
    predictor = settings.kind == "ancestral" or settings.langevin_predictor
    corrections = settings.langevin_inner - int(settings.langevin_predictor)
    step = settings.langevin_step
    for s, after in itertools.pairwise(levels):
        if settings.kind not in ("ancestral", "langevin"):
            yield s, 1 - after / s, 0.0, after
            continue
        if settings.kind == "langevin":
            for _ in range(corrections):
                yield s, 0.5 * step, math.sqrt(step) * s, s
        if predictor:
            yield s, 1 - (after / s) ** 2, after * math.sqrt(1 - (after / s) ** 2), after
    if settings.kind == "langevin" and not predictor:
        yield levels[-2], 1.0, 0.0, 0.0


class _Pose:
    """Poses on their way, with the moves that a sampler makes."""

    def __init__(
        self,
        rotation: Tensor,
        translation: Tensor,
        schedule: NoiseSchedule,
        generator: torch.Generator | None,
    ) -> None:
        self.rotation = rotation
        self.translation = translation
        self._schedule = schedule
        self._generator = generator

    def level(self, s: float) -> Tensor:
        """The level as a tensor (P,)."""
        return self.translation.new_full(self.translation.shape[:1], s)

    def add_noise(self, s: float) -> None:
        """Noise of level s of the schedule's process."""
        self.rotation, self.translation = perturb(
            self.rotation, self.translation, self.level(s), self._schedule, self._generator
        )

    def move(self, residual: Tensor, amount: float, noise: float) -> None:
        """Go `amount` (in levels) along the residual (P, 6), then add noise of level `noise`."""
        schedule = self._schedule
        residual = residual.to(self.translation.dtype)
        offset = (amount * schedule.sigma_t) * residual[:, :3]
        turn = so3.exp((amount * schedule.sigma_r) * residual[:, 3:])
        if noise > 0:
            eps = torch.randn(
                offset.shape,
                generator=self._generator,
                dtype=offset.dtype,
                device=offset.device,
            )
            offset = offset + (noise * schedule.sigma_t) * eps
            eta = igso3.sample(self.level(noise * schedule.sigma_r), self._generator)
            turn = turn @ so3.exp(eta)
        self.translation = self.translation + (self.rotation @ offset[..., None]).squeeze(-1)
        self.rotation = so3.orthonormalize(self.rotation @ turn)

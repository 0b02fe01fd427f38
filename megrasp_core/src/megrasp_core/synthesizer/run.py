"""One pass from cloud to ranked grasps."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from megrasp_core.diffusion import (
    Denoise,
    NoiseSchedule,
    SamplerSettings,
    SamplerStep,
    descend,
    last_step,
    refine,
)
from megrasp_core.errors import CancelledError
from megrasp_core.lie import PoseBatch
from megrasp_core.network import GraspModel, SceneField
from megrasp_core.pointcloud import Cloud, SceneSettings
from megrasp_core.ranking import rejection_counts

from .assessor import Assessor, MountedGripper
from .draw import Draw
from .hints import hints
from .perception import Perceived, perceive
from .polish import polish
from .poses import PoseSet, pose_set, world_from_tcp
from .repairs import backed_off, turned_over
from .request import SynthesisRequest
from .result import RankedGrasp, Synthesis
from .sampling import denoiser, draw_starts
from .scene_judge import Assessment
from .selection import rank_poses
from .settings import SynthesizerSettings
from .torch_threads import torch_threads
from .trace import OnTrace, Trace

__all__ = ["Cancelled", "OnPoses", "OnStep", "SynthesisRun"]

LOGGER = logging.getLogger(__name__)

OnStep = Callable[[str, int, int], None]
"""(phase, step, steps of the phase)."""

OnPoses = Callable[[PoseSet], None]
"""(unfinished poses, at most as many as are returned)."""

Cancelled = Callable[[], bool]

NEAR_NODE = 0.01
"""A node is part of an object whose points are nearer than this (m)."""

PHASES = ("perceive", "encode", "sample", "rank")


class SynthesisRun:
    """One synthesis, for one cloud."""

    def __init__(
        self,
        model: GraspModel,
        mounted: MountedGripper,
        request: SynthesisRequest,
        *,
        schedule: NoiseSchedule,
        sampler: SamplerSettings,
        scene_settings: SceneSettings,
        settings: SynthesizerSettings,
        on_step: OnStep | None = None,
        on_poses: OnPoses | None = None,
        on_trace: OnTrace | None = None,
        cancelled: Cancelled | None = None,
        at_once: int | None = None,
        threads: int = 1,
        offset: np.ndarray | None = None,
    ) -> None:
        """Take everything in; `offset` (3,): from the coordinates of the request to those in
        which hints name places (m), the rest as of `GraspSynthesizer`.
        """
        self.model, self.schedule, self.sampler = model, schedule, sampler
        self.settings, self.scene_settings = settings, scene_settings
        self.mounted, self.request = mounted, request
        self.on_step, self.on_poses, self.cancelled = on_step, on_poses, cancelled
        self.on_trace = on_trace
        self.at_once, self.threads = at_once, threads
        self.offset = offset
        self.centroid = np.zeros(3)
        self.timing: dict[str, float] = {}
        self.notes: tuple[str, ...] = ()
        self.drawn = 0
        self.generator = torch.Generator(device=self.model.device)
        self.generator.manual_seed(int(request.seed or 0))
        self.keep = request.drawn
        if request.mode == "default" and model.device.type == "cpu" and sampler.restarts:
            self.keep = min(self.settings.refined, request.drawn)

    def run(self, cloud: Cloud) -> Synthesis:
        """All phases; see `GraspSynthesizer.synthesize`."""
        start = time.perf_counter()
        request, ranking = self.request, self.settings.ranking
        with self._phase("perceive"):
            seen = perceive(cloud, request, self.scene_settings, ranking, self.threads)
        self.notes = seen.notes
        if seen.empty:
            self._trace(seen)
            return self._answer([], rejection_counts(np.zeros(0, "<U12")), start, empty=True)
        with self._phase("encode"):
            field = self.model.encode_scene(seen.nodes)
        self.centroid = seen.nodes.centroid
        assessor = Assessor(self.model, self.mounted, seen, field, self.at_once, self.threads)
        allowed = self._at_target(seen, field)
        draws: list[Draw] = []
        while self._goes_on(draws, assessor):
            draws.append(self._draw(field, assessor, allowed))
        with self._phase("rank"):
            drawn = Draw.of(draws)
            grasps, rejected = rank_poses(
                drawn.final, self.mounted.probe, request, ranking, drawn.left_out
            )
            parts = [(drawn.final, np.arange(len(drawn.final)))]
            parts += [drawn.left_out] if drawn.left_out else []
            told = hints(parts, seen.judge.observation, self.mounted.probe, request, self.offset)
            self._trace(seen, drawn)
        return self._answer(grasps, rejected, start, told=told)

    def _goes_on(self, draws: list[Draw], assessor: Assessor) -> bool:
        """Whether (more) poses are drawn: at first, and while no grasp is good."""
        if not draws or self.request.mode != "default" or not assessor.confident:
            return not draws
        best = max((draw.best_score for draw in draws), default=0.0)
        return best < self.settings.sure and len(draws) <= self.request.more_rounds

    def _draw(
        self, field: SceneField, assessor: Assessor, allowed: tuple[Tensor, Tensor] | None
    ) -> Draw:
        """Draw poses and bring them through everything."""
        request = self.request
        left_out: tuple[Assessment, np.ndarray] | None = None
        with self._timed("sample"):
            starts = draw_starts(
                self.model, field, self.mounted.code, request.drawn, self.generator, allowed
            )
            poses = descended = self._descend(field, starts)
            if self.keep < request.drawn:
                first = assessor.samples(poses, cheap=True)
                if self.settings.turns and self.mounted.probe.volume is not None:
                    first, turned = turned_over(first, lambda tcp: assessor.poses(tcp, cheap=True))
                    if len(turned):
                        poses = assessor.drawn(first.poses.tcp)
                best = self._best(first)
                left_out = first, np.setdiff1d(np.arange(request.drawn), best)
                poses = poses.part(torch.as_tensor(best, device=poses.device))
            refined = self._refine(field, poses)
        self.drawn += request.drawn
        with self._timed("rank"):
            final = assessor.samples(refined)
            if self.settings.back_off:
                final = backed_off(final, assessor.poses, self.settings.ranking.sweep)
            final = self._polished(assessor, final)
        sampled, gone_on = world_from_tcp(descended, self.centroid), np.arange(request.drawn)
        if left_out is not None:
            gone_on = np.setdiff1d(gone_on, left_out[1])
        sampled[gone_on] = world_from_tcp(refined, self.centroid)
        places = starts.cpu().double().numpy() + self.centroid
        return Draw(places, sampled, final, left_out)

    def _answer(
        self,
        grasps: list[RankedGrasp],
        rejected: dict[str, int],
        start: float,
        *,
        empty: bool = False,
        told: tuple[str, ...] = (),
    ) -> Synthesis:
        self.timing["total"] = time.perf_counter() - start
        if not grasps and rejected.get("score"):
            self.notes += (
                f"unsure: {rejected['score']} grasps pass the check, none of them with a score of "
                f"{self.request.min_score:g}. Look again, from another side if possible.",
            )
        LOGGER.debug(
            "synthesis: %d grasps, rejected %s, seconds %s", len(grasps), rejected, self.timing
        )
        return Synthesis(
            grasps=grasps,
            rejected=rejected,
            timing={name: self.timing.get(name, 0.0) for name in (*PHASES, "total")},
            seed=int(self.request.seed or 0),
            drawn=self.drawn,
            evaluations=self.sampler.evaluations,
            gripper=self.mounted.gripper.name,
            model=self.model.model_id,
            bin_empty=empty,
            notes=self.notes,
            hints=told,
        )

    def _at_target(self, seen: Perceived, field: SceneField) -> tuple[Tensor, Tensor] | None:
        """Masks of the fine and coarse nodes on the object that is asked for."""
        if self.request.target is None or seen.objects is None:
            return None
        fine, coarse = (
            torch.as_tensor(
                seen.objects.at(nodes.cpu().double().numpy() + seen.nodes.centroid, NEAR_NODE)
                == self.request.target,
                device=nodes.device,
            )
            for nodes in field.points[:2]
        )
        return fine, coarse

    def _descend(self, field: SceneField, starts: Tensor) -> PoseBatch:
        steps = descend(self._denoiser(field), starts, self.sampler, self.schedule, self.generator)
        with torch_threads(self.threads):
            return last_step(steps, self._report, self.cancelled).poses

    def _refine(self, field: SceneField, poses: PoseBatch) -> PoseBatch:
        sampler = self.sampler
        if sampler.restarts == 0 or len(poses) == 0:
            return poses
        steps = refine(self._denoiser(field), poses, sampler, self.schedule, self.generator)
        done = sampler.descend_evaluations
        later = (replace(step, index=done + step.index, total=done + step.total) for step in steps)
        with torch_threads(self.threads):
            return last_step(later, self._report, self.cancelled).poses

    def _denoiser(self, field: SceneField) -> Denoise:
        return denoiser(self.model, field, self.mounted.code, self.sampler, self.at_once)

    def _trace(self, seen: Perceived, drawn: Draw | None = None) -> None:
        """Tell who asked for it where the poses began, where they were sampled (after the descent
        and, those that went on, after the restarts), and what became of each.
        """
        if self.on_trace is None:
            return
        self.on_trace(
            Trace(
                self.request,
                seen.judge.observation,
                self.mounted.probe,
                np.zeros((0, 3)) if drawn is None else drawn.starts,
                np.zeros((0, 4, 4)) if drawn is None else drawn.sampled,
                None if drawn is None else drawn.assessment,
                np.zeros(3),
            )
        )

    def _polished(self, assessor: Assessor, final: Assessment) -> Assessment:
        if self.request.mode != "default" or not assessor.confident:
            return final

        def assess(tcp: np.ndarray, contacts: bool) -> Assessment:
            self._stop_if_cancelled("while ranking")
            return assessor.poses(tcp, contacts=contacts)

        rng = np.random.default_rng(int(self.request.seed or 0))
        probe, rank = self.mounted.probe, self.settings.ranking.rank
        return polish(final, assess, self.settings.polish, rng, probe.symmetry, rank)

    def _best(self, assessed: Assessment) -> np.ndarray:
        """Indices of the poses that go on: those that pass before those that do not, each by
        score.
        """
        order = np.lexsort((-assessed.score, ~assessed.check.passed))
        return np.sort(order[: self.keep])

    def _report(self, step: SamplerStep) -> None:
        if self.on_step is not None:
            evaluations = self.sampler.evaluations
            done = self.drawn // self.request.drawn * evaluations
            self.on_step("sample", done + step.index, done + evaluations)
        if self.on_poses is not None:
            first = step.poses.part(range(min(len(step.poses), self.request.num_grasps)))
            tcp = world_from_tcp(first, self.centroid)
            self.on_poses(pose_set(tcp, self.mounted.gripper, self.request))

    @contextmanager
    def _phase(self, name: str) -> Iterator[None]:
        """A phase that is told of when it is over."""
        with self._timed(name):
            yield
        if self.on_step is not None:
            self.on_step(name, 1, 1)
        self._stop_if_cancelled(f"after phase {name!r}")

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.timing[name] = self.timing.get(name, 0.0) + time.perf_counter() - start

    def _stop_if_cancelled(self, where: str) -> None:
        if self.cancelled is not None and self.cancelled():
            raise CancelledError(f"cancelled {where}")

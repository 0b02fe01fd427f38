"""One pass from cloud to ranked grasps."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from megrasp_core.diffusion import (
    NoiseSchedule,
    SamplerSettings,
    SamplerStep,
    descend,
    last_step,
    refine,
)
from megrasp_core.errors import CancelledError
from megrasp_core.grippers import Gripper
from megrasp_core.network import GraspModel, GripperCode, SceneField
from megrasp_core.pointcloud import Cloud, SceneNodes, SceneSettings, scene_nodes, surface_cloud
from megrasp_core.ranking import GripperProbe

from .evaluate import Assessment, SceneJudge
from .polish import polish
from .poses import PoseSet, pose_set, poses_of_tcp
from .request import SynthesisRequest
from .result import Synthesis
from .selection import Assessed, collect
from .settings import SynthesizerSettings
from .starts import draw_starts

__all__ = ["Cancelled", "MountedGripper", "OnStep", "SynthesisRun"]

LOGGER = logging.getLogger(__name__)

OnStep = Callable[[str, int, int], None]
"""(phase, step, steps of the phase)."""

Cancelled = Callable[[], bool]


@dataclass(frozen=True)
class MountedGripper:
    """A gripper as the model and the check see it."""

    gripper: Gripper
    code: GripperCode
    probe: GripperProbe


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
        cancelled: Cancelled | None = None,
    ) -> None:
        self.model, self.schedule, self.sampler = model, schedule, sampler
        self.settings, self.scene_settings = settings, scene_settings
        self.mounted, self.request = mounted, request
        self.on_step, self.cancelled = on_step, cancelled
        self.timing: dict[str, float] = {}
        self.generator = torch.Generator(device=self.model.device)
        self.generator.manual_seed(int(request.seed or 0))
        self.keep = request.drawn
        if request.mode == "default" and model.device.type == "cpu" and sampler.restarts:
            self.keep = min(self.settings.refined, request.drawn)
        self.total = sampler.evaluations

    def run(self, cloud: Cloud) -> Synthesis:
        """All phases; see `GraspSynthesizer.synthesize`."""
        start = time.perf_counter()
        nodes, judge = self._perceive(cloud)
        scene = self._encode(nodes)
        with self._phase("sample"):
            rotation, translation = self._descend(scene)
            rest: tuple[Assessed, np.ndarray] | None = None
            if self.keep < self.request.drawn:
                first = self._assess(judge, scene, nodes, rotation, translation, cheap=True)
                chosen = self._best(first[1])
                rest = first, np.setdiff1d(np.arange(self.request.drawn), chosen)
                rotation, translation = rotation[chosen], translation[chosen]
            rotation, translation = self._refine(scene, rotation, translation)
        with self._phase("rank"):
            final = self._assess(judge, scene, nodes, rotation, translation, cheap=False)
            final = self._polished(final, judge, scene, nodes)
            grasps, rejected = collect(
                final, rest, self.mounted.probe, self.request, self.settings.ranking
            )
        self._tell("rank", 1, 1)
        self.timing["total"] = time.perf_counter() - start
        LOGGER.debug(
            "synthesis: %d grasps, rejected %s, seconds %s", len(grasps), rejected, self.timing
        )
        return Synthesis(
            grasps=grasps,
            rejected=rejected,
            timing=self.timing,
            seed=int(self.request.seed or 0),
            drawn=self.request.drawn,
            evaluations=self.total,
            gripper=self.mounted.gripper.name,
            model=self.model.model_id,
        )

    def _perceive(self, cloud: Cloud) -> tuple[SceneNodes, SceneJudge]:
        request = self.request
        with self._phase("perceive"):
            surface = surface_cloud(
                cloud,
                sensor=request.sensor,
                gravity=request.gravity,
                region=request.region,
                settings=self.scene_settings,
            )
            nodes = scene_nodes(surface, self.scene_settings)
            judge = SceneJudge(surface, request, self.settings.ranking)
        self._tell("perceive", 1, 1)
        return nodes, judge

    def _encode(self, nodes: SceneNodes) -> SceneField:
        with self._phase("encode"):
            scene = self.model.encode_scene(nodes)
        self._tell("encode", 1, 1)
        return scene

    def _descend(self, scene: SceneField) -> tuple[Tensor, Tensor]:
        starts = draw_starts(
            self.model, scene, self.mounted.code, self.request.drawn, self.generator
        )
        steps = descend(self._denoiser(scene), starts, self.sampler, self.schedule, self.generator)
        last = last_step(steps, self._sampled, self.cancelled)
        return last.rotation, last.translation

    def _refine(
        self, scene: SceneField, rotation: Tensor, translation: Tensor
    ) -> tuple[Tensor, Tensor]:
        sampler = self.sampler
        if sampler.restarts == 0 or len(rotation) == 0:
            return rotation, translation
        done = sampler.descend_evaluations

        def tell(step: SamplerStep) -> None:
            self._sampled(replace(step, index=done + step.index))

        steps = refine(
            self._denoiser(scene), rotation, translation, sampler, self.schedule, self.generator
        )
        last = last_step(steps, tell, self.cancelled)
        return last.rotation, last.translation

    def _denoiser(self, scene: SceneField) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
        def denoise(rotation: Tensor, translation: Tensor, s: Tensor) -> Tensor:
            said = self.model.predict(scene, self.mounted.code, rotation, translation, s)
            if self.sampler.uses_score:
                return torch.cat([said.residual[:, :3], said.score], dim=-1)
            return said.residual

        return denoise

    def _assess(
        self,
        judge: SceneJudge,
        scene: SceneField,
        nodes: SceneNodes,
        rotation: Tensor,
        translation: Tensor,
        *,
        cheap: bool,
    ) -> tuple[PoseSet, Assessment]:
        poses = pose_set(rotation, translation, nodes.centroid, self.mounted.gripper, self.request)
        return poses, self._judged(poses, judge, scene, rotation, translation, cheap=cheap)

    def _judged(
        self,
        poses: PoseSet,
        judge: SceneJudge,
        scene: SceneField,
        rotation: Tensor,
        translation: Tensor,
        *,
        cheap: bool = False,
        contacts: bool = True,
    ) -> Assessment:
        confidence = None
        if "confidence" in self.model.info.heads:
            logit = self.model.confidence(scene, self.mounted.code, rotation, translation)
            confidence = logit.sigmoid().cpu().double().numpy()
        return judge.assess(poses, self.mounted.probe, confidence, cheap=cheap, contacts=contacts)

    def _polished(
        self, final: Assessed, judge: SceneJudge, scene: SceneField, nodes: SceneNodes
    ) -> Assessed:
        settings = self.settings.polish
        if self.request.mode != "default" or "confidence" not in self.model.info.heads:
            return final

        def assess(tcp: np.ndarray, contacts: bool) -> Assessed:
            self._ask()
            poses = poses_of_tcp(tcp, self.mounted.gripper, self.request)
            kind = {"dtype": self.model.dtype, "device": self.model.device}
            rotation = torch.tensor(tcp[:, :3, :3], **kind)
            translation = torch.tensor(tcp[:, :3, 3] - nodes.centroid, **kind)
            return poses, self._judged(
                poses, judge, scene, rotation, translation, contacts=contacts
            )

        rng = np.random.default_rng(int(self.request.seed or 0))
        probe, rank = self.mounted.probe, self.settings.ranking.rank
        return polish(final, assess, settings, rng, probe.symmetry, rank)

    def _best(self, assessment: Assessment) -> np.ndarray:
        """Indices of the poses that go on: those that pass before those that do not, each by
        score.
        """
        order = np.lexsort((-assessment.score, ~assessment.check.passed))
        return np.sort(order[: self.keep])

    def _sampled(self, step: SamplerStep) -> None:
        self._tell("sample", step.index, self.total)

    def _tell(self, phase: str, step: int, total: int) -> None:
        if self.on_step is not None:
            self.on_step(phase, step, total)
        if phase != "sample":
            self._ask(f"after phase {phase!r}")

    def _ask(self, where: str = "while ranking") -> None:
        if self.cancelled is not None and self.cancelled():
            raise CancelledError(f"cancelled {where}")

    @contextmanager
    def _phase(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.timing[name] = time.perf_counter() - start

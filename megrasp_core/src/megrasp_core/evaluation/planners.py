"""What an evaluation asks for grasps: the model, or the analytic antipodal baseline behind the
same check.
"""

from __future__ import annotations

import copy
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.grippers import Gripper
from megrasp_core.objects import ObjectModel
from megrasp_core.pointcloud import Cloud, SceneNodes, neighbours
from megrasp_core.ranking import GripperProbe, gripper_probe
from megrasp_core.simulation import World
from megrasp_core.synthesizer import (
    REPAIRS,
    Assessment,
    GraspSynthesizer,
    Synthesis,
    SynthesisRequest,
    SynthesizerSettings,
    backed_off,
    perceive,
    pose_set,
    rank_poses,
)


class Planner(ABC):
    """Anything that turns a cloud into a `Synthesis`."""

    name: str

    @abstractmethod
    def plan(self, cloud: Cloud, **options: Any) -> Synthesis:
        """Grasps for a cloud; options as of `SynthesisRequest`."""

    def raw(self) -> Planner:
        """The same planner without what moves samples after they were drawn."""
        return self

    def facts(self) -> dict[str, Any]:
        """What decides on the plans, besides the gripper and the code: plain values."""
        return {"name": self.name}

    def look_inside(self, world: World, models: Mapping[int, ObjectModel]) -> None:  # noqa: B027
        """Told before each plan of the true scene and of the objects that may be lifted, by place;
        only a planner that is to know more than the camera makes use of it.
        """


class ModelPlanner(Planner):
    """The trained model."""

    def __init__(self, synthesizer: GraspSynthesizer) -> None:
        self.synthesizer = synthesizer
        self.name = synthesizer.model.model_id

    @property
    def sampler(self) -> SamplerSettings:
        """The sampler that a pose goes through."""
        return self.synthesizer.sampler

    def plan(self, cloud: Cloud, **options: Any) -> Synthesis:
        """See `GraspSynthesizer.synthesize`."""
        return self.synthesizer.synthesize(cloud, **options)

    def facts(self) -> dict[str, Any]:
        """Name and weights of the model, the settings with the calibration."""
        weights, settings = self.synthesizer.model.info.sha256, self.synthesizer.calibrated
        return {"name": self.name, "weights": weights, "settings": repr(settings)}

    def raw(self) -> ModelPlanner:
        """The sampler alone, with the same model and the gripper as it is encoded."""
        synthesizer = copy.copy(self.synthesizer)
        synthesizer.settings = synthesizer.settings.without(REPAIRS)
        return ModelPlanner(synthesizer)


@dataclass(frozen=True)
class AntipodalSettings:
    """How candidates are drawn from the seen surface.

    Attributes:
        cone: largest angle (rad) between a contact's normal and the closing axis.
        approach_tilt: standard deviation (rad) of the approach about straight down.
        depth: the TCP lies up to this far (m) below the contacts' height.
        edge_share: share of candidates from single points and their nearest edge direction, for
            objects of which only the top is seen.
        pairs: of points that are looked at.
    """

    cone: float = float(np.deg2rad(30.0))
    approach_tilt: float = 0.25
    depth: float = 0.02
    edge_share: float = 0.5
    pairs: int = 4000


class AntipodalPlanner(Planner):
    """Analytic antipodal candidates, with the check and the ranking of the model's samples.

    Half of the candidates are pairs of seen points whose normals oppose along the closing axis and
    whose distance fits the opening. A top-down camera sees few such pairs, so the other half take
    a seen point off the support plane, approach it against gravity and close along the direction
    in which the seen patch is narrowest.
    """

    name = "antipodal-baseline"

    def __init__(
        self,
        gripper: Gripper,
        settings: AntipodalSettings | None = None,
        synthesizer: SynthesizerSettings | None = None,
    ) -> None:
        self.gripper = gripper
        self.settings = settings or AntipodalSettings()
        self.options = synthesizer or SynthesizerSettings()
        self._probe: GripperProbe = gripper_probe(gripper, self.options.probe)

    def plan(self, cloud: Cloud, **options: Any) -> Synthesis:
        """Candidates through the same check; `drawn` of them."""
        began = time.perf_counter()
        request, ranking = SynthesisRequest.of(**options), self.options.ranking
        seen = perceive(cloud, request, None, ranking)
        tcp = self.candidates(seen.nodes, request.drawn, np.random.default_rng(request.seed))

        def assess(tcp: np.ndarray) -> Assessment:
            return seen.judge.assess(pose_set(tcp, self.gripper, request), self._probe, None)

        assessed = assess(tcp)
        if self.options.back_off:
            assessed = backed_off(assessed, assess, ranking.sweep)
        grasps, rejected = rank_poses(assessed, self._probe, request, ranking)
        return Synthesis(
            grasps=grasps,
            rejected=rejected,
            timing={"total": time.perf_counter() - began},
            seed=int(request.seed or 0),
            drawn=request.drawn,
            evaluations=0,
            gripper=self.gripper.name,
            model=self.name,
        )

    def facts(self) -> dict[str, Any]:
        """Name and settings."""
        return {"name": self.name, "settings": repr((self.settings, self.options))}

    def raw(self) -> AntipodalPlanner:
        """The candidates as they are drawn."""
        return AntipodalPlanner(self.gripper, self.settings, self.options.without(REPAIRS))

    def candidates(self, nodes: SceneNodes, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw `(count, 4, 4)` TCP poses in the frame of the cloud."""
        down = nodes.gravity.astype(np.float64) if nodes.gravity.any() else np.array([0, 0, -1.0])
        points = nodes.points.astype(np.float64) + nodes.centroid
        normals = nodes.normals.astype(np.float64)
        off = ~nodes.on_plane
        if off.sum() >= 10:
            points, normals = points[off], normals[off]
        wanted = round(count * (1 - self.settings.edge_share))
        pairs = self._pairs(points, normals, down, wanted, rng)
        edges = self._edges(points, down, count - len(pairs), rng)
        return np.concatenate([pairs, edges])

    def _pairs(
        self,
        points: np.ndarray,
        normals: np.ndarray,
        down: np.ndarray,
        count: int,
        rng: np.random.Generator,
    ) -> np.ndarray:
        width = self.gripper.description.max_width or 0.10
        first = rng.integers(len(points), size=self.settings.pairs)
        second = rng.integers(len(points), size=self.settings.pairs)
        axis = points[second] - points[first]
        length = np.linalg.norm(axis, axis=1)
        axis = axis / np.maximum(length, 1e-9)[:, None]
        limit = np.cos(self.settings.cone)
        opposed = (
            (length > 0.005)
            & (length < width - 0.003)
            & (-(normals[first] * axis).sum(1) > limit)
            & ((normals[second] * axis).sum(1) > limit)
        )
        chosen = np.flatnonzero(opposed)[:count]
        centre = (points[first] + points[second])[chosen] / 2
        return self._frames(centre, axis[chosen], down, rng)

    def _edges(
        self, points: np.ndarray, down: np.ndarray, count: int, rng: np.random.Generator
    ) -> np.ndarray:
        index = rng.integers(len(points), size=count)
        reach = (self.gripper.description.max_width or 0.10) / 2
        distance, near = neighbours(points[index], points, min(64, len(points)))
        patch = points[near] - points[index][:, None]
        weight = (distance < reach)[..., None]
        flat = (patch - (patch @ down)[..., None] * down) * weight
        _, _, axes = np.linalg.svd(flat, full_matrices=False)
        sideways = axes[:, 1] - (axes[:, 1] @ down)[:, None] * down
        middle = (patch * weight).sum(1) / weight.sum(1)
        return self._frames(points[index] + middle, sideways, down, rng)

    def _frames(
        self, centre: np.ndarray, axis: np.ndarray, down: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        x = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
        tilt = rng.normal(scale=self.settings.approach_tilt, size=(len(x), 3))
        z = down + tilt
        z = z - (z * x).sum(1, keepdims=True) * x
        z /= np.maximum(np.linalg.norm(z, axis=1, keepdims=True), 1e-9)
        poses = np.tile(np.eye(4), (len(x), 1, 1))
        poses[:, :3, 0], poses[:, :3, 2] = x, z
        poses[:, :3, 1] = np.cross(z, x)
        sink = rng.uniform(0, self.settings.depth, (len(x), 1))
        poses[:, :3, 3] = centre + sink * z
        return poses

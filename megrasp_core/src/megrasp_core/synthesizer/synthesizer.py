"""`GraspSynthesizer`: cloud in, ranked grasps out. One for the CLI, the evaluation and the ROS
node.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from megrasp_core.diffusion import NoiseSchedule, SamplerSettings
from megrasp_core.errors import EmptyRegionError, InvalidRequestError, SensorPlaceError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.network import DefaultModels, GraspModel, load_model
from megrasp_core.pointcloud import Cloud, SceneSettings, check_view
from megrasp_core.ranking import GripperProbe, gripper_probe

from .assessor import Assessor, MountedGripper
from .perception import perceive
from .request import SynthesisRequest
from .result import Synthesis
from .run import Cancelled, OnPoses, OnStep, SynthesisRun
from .scene_judge import Assessment
from .settings import SynthesizerSettings
from .torch_threads import torch_threads
from .trace import OnTrace

__all__ = ["GraspSynthesizer"]

KEPT_GRIPPERS = 64
"""Grippers whose codes and probes are kept: one or two MB each."""
FAR = 100.0
"""Farther from the origin (m) a scene is moved there for the time of a synthesis."""


class GraspSynthesizer:
    """A model and a gripper, ready for clouds.

    The scene is encoded once per cloud, a gripper once in the life of the synthesizer. Not for
    several threads at a time.

        synthesizer = GraspSynthesizer.load(gripper="robotiq_2f85")
        grasps = synthesizer.synthesize(read_cloud("bin.ply"), num_grasps=20, gravity=(0, 0,
        -1)).grasps
    """

    def __init__(
        self,
        model: GraspModel | DefaultModels,
        gripper: Gripper | str | Path | None = None,
        *,
        settings: SynthesizerSettings | None = None,
        threads: int | None = None,
    ) -> None:
        """Take a loaded model.

        Args:
            model: on its device, in evaluation mode; or the default models, of which that for the
                kind of the gripper is used.
            gripper: name, folder or loaded gripper; may be set later.
            settings: see `SynthesizerSettings`.
            threads: torch threads of the decoder; None: as many as torch has been told.

        Raises:
            UnknownGripperError, DescriptionError, InvalidRequestError.
        """
        if threads is not None and threads < 1:
            raise InvalidRequestError(
                f"threads {threads} was given; expected at least 1, or none."
            )
        self._model = model
        self.settings = settings or SynthesizerSettings()
        self.threads = threads
        self._encoded: dict[str, MountedGripper] = {}
        self._mounted: MountedGripper | None = None
        if gripper is not None:
            self.set_gripper(gripper)

    @classmethod
    def load(
        cls,
        model: str | Path | None = None,
        gripper: Gripper | str | Path | None = None,
        device: str = "cpu",
        threads: int | None = None,
        settings: SynthesizerSettings | None = None,
    ) -> GraspSynthesizer:
        """Load a model by id or folder (None: the default for the kind of the gripper) and set a
        gripper.

        Raises:
            ModelError: the model is missing or damaged.
            UnknownGripperError, DescriptionError: about the gripper.
        """
        loaded = DefaultModels(device) if model is None else load_model(model, device=device)
        return cls(loaded, gripper, settings=settings, threads=threads)

    @property
    def gripper(self) -> Gripper | None:
        """The gripper that grasps are made for."""
        return self._mounted.gripper if self._mounted else None

    @property
    def model(self) -> GraspModel:
        """The model that grasps are made with."""
        return self._mounted.model if self._mounted else self.model_for(None)

    def model_for(self, gripper: Gripper | None) -> GraspModel:
        """The model that makes grasps for a gripper, or for any (None).

        Raises:
            ModelError: a default model is missing or damaged.
        """
        if isinstance(self._model, DefaultModels):
            return self._model.of(gripper.description.kind if gripper else None)
        return self._model

    @property
    def sampler(self) -> SamplerSettings:
        """The one of the settings, or the model's."""
        return self.settings.sampler or self.model.info.sampler

    @property
    def scene_settings(self) -> SceneSettings:
        """Those of the settings, or the model's."""
        return self.settings.scene or self.model.info.scene

    @property
    def probe(self) -> GripperProbe | None:
        """What the check uses of the gripper."""
        return self._mounted.probe if self._mounted else None

    @property
    def calibrated(self) -> SynthesizerSettings:
        """The settings with the calibration that the model's config.json states for the gripper,
        unless they bring their own: what every score is made with.
        """
        rank, gripper = self.settings.ranking.rank, self.gripper
        if gripper is None or rank.calibration is not None:
            return self.settings
        stated = self.model.info.calibration_for(gripper.name, gripper.description.kind)
        ranking = replace(self.settings.ranking, rank=replace(rank, calibration=stated))
        return replace(self.settings, ranking=ranking)

    def set_gripper(self, gripper: Gripper | str | Path) -> Gripper:
        """Encode a gripper, or take it from the cache, and use it from now on.

        Args:
            gripper: registered name, folder of a gripper.yaml, or a loaded gripper.

        Raises:
            UnknownGripperError, DescriptionError: the gripper in use stays.
            ModelError: the default model for its kind is missing; likewise.
        """
        loaded = gripper if isinstance(gripper, Gripper) else load_gripper(gripper)
        mounted = self._encoded.pop(loaded.hash, None)
        if mounted is None:
            model = self.model_for(loaded)
            with self._running():
                tokens = loaded.tokens(
                    count=model.config.gripper_tokens, seed=self.settings.gripper_seed
                )
                code = model.encode_gripper(tokens)
            probe = gripper_probe(loaded, self.settings.probe)
            mounted = MountedGripper(loaded, model, code, probe)
        # The one used last is the last; the one unused for longest goes.
        self._encoded[loaded.hash] = self._mounted = mounted
        while len(self._encoded) > KEPT_GRIPPERS:
            del self._encoded[next(iter(self._encoded))]
        return self._mounted.gripper

    def synthesize(
        self,
        cloud: Cloud,
        request: SynthesisRequest | None = None,
        *,
        on_step: OnStep | None = None,
        on_poses: OnPoses | None = None,
        on_trace: OnTrace | None = None,
        cancelled: Cancelled | None = None,
        at_once: int | None = None,
        **options: Any,
    ) -> Synthesis:
        """Draw grasps for a cloud, check and rank them.

        Args:
            cloud: in any frame, metres.
            request: what is asked for; or give
            options: the attributes of `SynthesisRequest` by name, such as num_grasps, gravity,
                sensor, region.
            on_step: called with (phase, step, steps of the phase); phases perceive, encode,
                sample, rank.
            on_poses: called after each step of the sampler with poses as they are then: neither
                finished nor checked, in no order.
            on_trace: called at the end with what became of every drawn pose.
            cancelled: asked between steps.
            at_once: poses that the network takes at a time, where memory is short; None: all.

        Raises:
            InvalidRequestError, GravityError, CloudError, EmptyRegionError, CancelledError. What
            `is_out_of_memory` tells apart where memory is not enough.
        """
        if request is not None and options:
            raise InvalidRequestError(
                f"a request and the options {sorted(options)} were given; expected one or the "
                "other."
            )
        request = request or SynthesisRequest.of(**options)
        if self._mounted is None:
            raise InvalidRequestError("no gripper is set; expected one. Call set_gripper first.")
        check_view(
            cloud.points,
            sensor=cloud.viewpoint if request.sensor is None else request.sensor,
            gravity=request.gravity,
            region=request.region,
        )
        offset, given = _far_origin(cloud), (cloud, request)
        if offset.any():
            cloud, request = cloud.moved(-offset), request.moved(-offset)
            if on_poses is not None:
                on_poses = _moved_back(on_poses, offset)
            if on_trace is not None:
                on_trace = _with_offset(on_trace, offset)
        threads = self.threads or torch.get_num_threads()
        with self._running(), self._told_as(*given, offset):
            result = SynthesisRun(
                self.model,
                self._mounted,
                request,
                schedule=NoiseSchedule.of(self.model.config),
                sampler=self.sampler,
                scene_settings=self.scene_settings,
                settings=self.calibrated,
                on_step=on_step,
                on_poses=on_poses,
                on_trace=on_trace,
                cancelled=cancelled,
                at_once=at_once,
                threads=threads,
                offset=offset,
            ).run(cloud)
        if offset.any():
            result = replace(result, grasps=[grasp.moved(offset) for grasp in result.grasps])
        return result

    def assess(self, cloud: Cloud, world_from_tcp: np.ndarray, **options: Any) -> Assessment:
        """What the model and the check say of given grasps, in the order that they are given.

        Args:
            cloud: in any frame, metres.
            world_from_tcp: (N, 4, 4) in the frame of the cloud.
            options: the attributes of `SynthesisRequest` by name.

        Raises:
            InvalidRequestError, GravityError, CloudError, EmptyRegionError.
        """
        if self._mounted is None:
            raise InvalidRequestError("no gripper is set; expected one. Call set_gripper first.")
        request = SynthesisRequest.of(**options)
        tcp = np.array(world_from_tcp, dtype=np.float64)
        offset, given = _far_origin(cloud), (cloud, request)
        if offset.any():
            cloud, request = cloud.moved(-offset), request.moved(-offset)
            tcp[:, :3, 3] -= offset
        with self._running(), self._told_as(*given, offset):
            seen = perceive(cloud, request, self.scene_settings, self.calibrated.ranking)
            field = self.model.encode_scene(seen.nodes)
            found = Assessor(self.model, self._mounted, seen, field).poses(tcp)
        return replace(found, poses=found.poses.moved(offset)) if offset.any() else found

    @contextmanager
    def _running(self) -> Iterator[None]:
        """No gradients, and one thread: only the decoder gains by more, and threads that wait
        for work slow everything else down.
        """
        with torch_threads(1), torch.inference_mode():
            yield

    @contextmanager
    def _told_as(
        self, cloud: Cloud, request: SynthesisRequest, offset: np.ndarray
    ) -> Iterator[None]:
        """Errors that name places name them in the frame of the cloud as it was given, which is
        looked at once more for that.
        """
        try:
            yield
        except (EmptyRegionError, SensorPlaceError):
            if offset.any():
                perceive(cloud, request, self.scene_settings, self.settings.ranking)
            raise


def _moved_back(on_poses: OnPoses, offset: np.ndarray) -> OnPoses:
    return lambda poses: on_poses(poses.moved(offset))


def _with_offset(on_trace: OnTrace, offset: np.ndarray) -> OnTrace:
    return lambda trace: on_trace(replace(trace, offset=offset))


def _far_origin(cloud: Cloud) -> np.ndarray:
    """A place (3,) near the scene where numbers of 32 bits would lose its shape, else zeros."""
    points = cloud.finite().points
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    return np.round(middle) if np.linalg.norm(middle) > FAR else np.zeros(3)

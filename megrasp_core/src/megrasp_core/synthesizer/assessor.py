"""All there is to say of poses of one gripper in one scene: the confidence of the model and the
judgement on what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from megrasp_core.grippers import Gripper
from megrasp_core.lie import PoseBatch
from megrasp_core.network import GraspModel, GripperCode, SceneField
from megrasp_core.ranking import GripperProbe

from .parts import in_parts
from .perception import Perceived
from .poses import pose_set, scene_from_tcp, world_from_tcp
from .scene_judge import Assessment
from .torch_threads import torch_threads

__all__ = ["Assessor", "MountedGripper"]


@dataclass(frozen=True)
class MountedGripper:
    """A gripper as the model and the check see it, and the model that plans for it."""

    gripper: Gripper
    model: GraspModel
    code: GripperCode
    probe: GripperProbe


class Assessor:
    """Assesses poses, given as the model draws them or in the frame of the cloud."""

    def __init__(
        self,
        model: GraspModel,
        mounted: MountedGripper,
        seen: Perceived,
        field: SceneField,
        at_once: int | None = None,
        threads: int = 1,
    ) -> None:
        """Take a scene; `at_once`: see `GraspSynthesizer.synthesize`; `threads`: of the model."""
        self._model, self._mounted = model, mounted
        self._seen, self._field = seen, field
        self._at_once, self._threads = at_once, threads
        self.confident = "confidence" in model.info.heads
        """Whether the model has a confidence."""

    def samples(self, poses: PoseBatch, *, cheap: bool = False) -> Assessment:
        """Of scene_from_tcp poses.

        Args:
            poses: N of them, centred scene coordinates.
            cheap: the approach path is not tested, with the coarse points only.
        """
        tcp = world_from_tcp(poses, self._seen.nodes.centroid)
        return self._assess(tcp, poses, cheap=cheap, contacts=True)

    def poses(self, tcp: np.ndarray, *, cheap: bool = False, contacts: bool = True) -> Assessment:
        """Of world_from_tcp poses.

        Args:
            tcp: (N, 4, 4).
            cheap: the approach path is not tested, with the coarse points only.
            contacts: measure what lies between the fingers, the slowest part.
        """
        return self._assess(tcp, self.drawn(tcp), cheap=cheap, contacts=contacts)

    def drawn(self, tcp: np.ndarray) -> PoseBatch:
        """World_from_tcp poses (N, 4, 4) as the model draws them: scene_from_tcp."""
        centroid = self._seen.nodes.centroid
        return scene_from_tcp(tcp, centroid, self._model.dtype, self._model.device)

    def _assess(
        self, tcp: np.ndarray, poses: PoseBatch, *, cheap: bool, contacts: bool
    ) -> Assessment:
        mounted, judge = self._mounted, self._seen.judge
        confidence = None
        if self.confident:
            with torch_threads(self._threads):
                logit = in_parts(
                    lambda rows: self._model.confidence(
                        self._field, mounted.code, poses.part(rows)
                    ),
                    len(poses),
                    self._at_once,
                )
            confidence = logit.sigmoid().cpu().double().numpy()
        return judge.assess(
            pose_set(tcp, mounted.gripper, judge.request),
            mounted.probe,
            confidence,
            cheap=cheap,
            contacts=contacts,
        )

"""The check, the contact measurement and the score of poses: one code for every stage."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from megrasp_core.pointcloud import Plane, SurfaceCloud
from megrasp_core.ranking import (
    Contacts,
    ContactSurface,
    GraspCheck,
    GripperProbe,
    SceneObservation,
    check_grasps,
    contact_surface,
    excluded,
    measure_contacts,
    score_grasps,
)

from .poses import PoseSet
from .request import SynthesisRequest
from .settings import RankingSettings

__all__ = ["Assessment", "SceneJudge", "seen_plane"]


@dataclass(frozen=True)
class Assessment:
    """N poses and what is known of them.

    Attributes:
        poses: in the frame of the cloud.
        check: against what was seen.
        contacts: None where the fingers do not close along X.
        confidence: (N,), None without that head.
        score: (N,).
    """

    poses: PoseSet
    check: GraspCheck
    contacts: Contacts | None
    confidence: np.ndarray | None
    score: np.ndarray

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.score)


class SceneJudge:
    """Assesses poses against one observed scene.

    The analytic baseline and the model's samples go through the same one.
    """

    def __init__(
        self,
        surface: SurfaceCloud,
        request: SynthesisRequest,
        settings: RankingSettings | None = None,
    ) -> None:
        """Draw the depth image and select the points that can be material.

        Args:
            surface: preprocessed cloud.
            request: region, walls, limits and excluded poses.
            settings: of the ranking.
        """
        self.settings = settings or RankingSettings()
        self.request = request
        plane = seen_plane(surface)
        self.observation = SceneObservation(
            surface.crop,
            surface.sensor,
            gravity=surface.gravity,
            region=request.region,
            walls=request.walls,
            floor=plane,
            surface_points=surface.points,
            views=surface.views,
            settings=self.settings.observation,
        )
        self.material = self._material(surface, plane)

    def assess(
        self,
        poses: PoseSet,
        probe: GripperProbe,
        confidence: np.ndarray | None,
        *,
        cheap: bool = False,
        contacts: bool = True,
    ) -> Assessment:
        """Check and score poses.

        Args:
            poses: N poses.
            probe: of the gripper.
            confidence: (N,) probability of success or None.
            cheap: the approach path is not tested, with the coarse points only.
            contacts: measure what lies between the fingers, the slowest part.
        """
        request, s = self.request, self.settings
        if cheap:
            probe = replace(probe, points=probe.approach_points)
        check = check_grasps(
            self.observation,
            probe,
            poses.gripper,
            None if cheap else poses.approach,
            s.check,
            max_tilt=request.max_tilt,
        )
        between = None
        if contacts and probe.volume is not None:
            between = measure_contacts(self.material, probe.volume, poses.gripper, s.contact)
            check.reject(between.count < s.contact.min_points, "empty")
        failed = np.asarray(request.exclude)
        again = excluded(poses.tcp, failed, request.exclude_radius, probe.symmetry)
        check.reject(again, "excluded")
        score = score_grasps(check, between, confidence, s.rank)
        return Assessment(poses, check, between, confidence, score)

    def _material(self, surface: SurfaceCloud, plane: Plane | None) -> ContactSurface:
        """Seen points off the support plane and, in a bin, off its floor and walls."""
        s = self.settings.contact

        def distance(points: np.ndarray) -> np.ndarray:
            height = np.full(len(points), np.inf) if plane is None else plane.height(points)
            if not self.observation.walls:
                return height
            outside = ~self.observation.contains(points)
            nearest = np.minimum(height, self.observation.structure_distance(points))
            return np.where(outside, 0.0, nearest)

        return contact_surface(
            surface.crop,
            surface.points,
            surface.normals,
            distance(surface.crop),
            distance(surface.points),
            settings=s,
        )


def seen_plane(surface: SurfaceCloud) -> Plane | None:
    """Support plane through the points that are flagged to lie on it, or None where too few
    are.
    """
    points = surface.points[surface.on_plane]
    if len(points) < 30:
        return None
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    up = surface.sensor - middle if surface.gravity is None else -surface.gravity
    normal = normal if normal @ up > 0 else -normal
    return Plane(normal, float(normal @ middle))

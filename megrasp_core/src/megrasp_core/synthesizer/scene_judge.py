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
    hits_on_the_way,
    measure_contacts,
    score_grasps,
    sweep_hits,
)

from .objects import LabelledObjects
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
        share: (N,) of the stroke at which the fingers start, 0 fully open.
        opening: (N,) between the pads before closing (m); NaN for hands.
        object: (N,) label of what is grasped, 0: none; 0 as well where that was not asked.
    """

    poses: PoseSet
    check: GraspCheck
    contacts: Contacts | None
    confidence: np.ndarray | None
    score: np.ndarray
    share: np.ndarray
    opening: np.ndarray
    object: np.ndarray

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
        objects: LabelledObjects | None = None,
    ) -> None:
        """Draw the depth image and select the points that can be material.

        Args:
            surface: preprocessed cloud.
            request: region, walls, limits and excluded poses.
            settings: of the ranking.
            objects: of the same surface, where it has labels.
        """
        self.settings = settings or RankingSettings()
        self.objects = objects
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
        probes = (probe, *probe.narrower)
        if cheap:
            probes = tuple(replace(one, points=one.approach_points) for one in probes)
        check, level = self._check(poses, probes, with_approach=not cheap)
        between = None
        if contacts and probe.volume is not None:
            between = self._contacts(poses, probes, level)
            filled = between.width > np.array([p.opening for p in probes])[level] - s.least_room
            check.reject(filled & (level > 0), "collision")
            check.reject(between.count < s.contact.min_points, "empty")
            if not cheap:
                self._check_closing(poses, probes, level, between, check)
        label = np.zeros(len(poses), dtype=np.int32)
        if self.objects is not None and (request.target is not None or not cheap):
            label = self.objects.grasped(poses.gripper, probe)
        if request.target is not None:
            check.reject(label != request.target, "object")
        if contacts and not cheap:
            self._check_retreat(poses, probes, level, check)
        failed = np.asarray(request.exclude)
        again = excluded(poses.tcp, failed, request.exclude_radius, probe.symmetry)
        check.reject(again, "excluded")
        score = score_grasps(check, between, confidence, s.rank)
        if not cheap:
            check.reject(score < request.min_score, "score")
        share = np.array([one.share for one in probes])[level]
        opening = np.array([one.opening for one in probes])[level]
        return Assessment(poses, check, between, confidence, score, share, opening, label)

    def _check(
        self, poses: PoseSet, probes: tuple[GripperProbe, ...], *, with_approach: bool
    ) -> tuple[GraspCheck, np.ndarray]:
        """The check at the widest opening that is free, and which one that is (N,)."""
        level = np.zeros(len(poses), dtype=np.int64)

        def checked(probe: GripperProbe, rows: np.ndarray) -> GraspCheck:
            return check_grasps(
                self.observation,
                probe,
                poses.gripper[rows],
                poses.approach[rows] if with_approach else None,
                self.settings.check,
                max_tilt=self.request.max_tilt,
            )

        check = checked(probes[0], np.arange(len(poses)))
        for index, narrower in enumerate(probes[1:], start=1):
            rows = np.flatnonzero(check.reason == "collision")
            if not len(rows):
                break
            tried = checked(narrower, rows)
            free = np.flatnonzero(tried.passed)
            check.put(rows[free], tried, free)
            level[rows[free]] = index
        return check, level

    def _contacts(
        self, poses: PoseSet, probes: tuple[GripperProbe, ...], level: np.ndarray
    ) -> Contacts:
        """What lies between the fingers at the opening of each grasp."""

        def measured(probe: GripperProbe, rows: np.ndarray) -> Contacts:
            assert probe.volume is not None
            return measure_contacts(
                self.material, probe.volume, poses.gripper[rows], self.settings.contact
            )

        between = measured(probes[0], np.arange(len(poses)))
        for index, probe in enumerate(probes[1:], start=1):
            rows = np.flatnonzero(level == index)
            if len(rows):
                between.put(rows, measured(probe, rows))
        return between

    def _check_closing(
        self,
        poses: PoseSet,
        probes: tuple[GripperProbe, ...],
        level: np.ndarray,
        between: Contacts,
        check: GraspCheck,
    ) -> None:
        s = self.settings.sweep
        for index, probe in enumerate(probes):
            rows = np.flatnonzero((level == index) & check.passed)
            found = between.part(rows)
            hits = sweep_hits(self.observation, probe, poses.gripper[rows], found, s)
            check.reason[rows[hits]] = "sweep"

    def _check_retreat(
        self,
        poses: PoseSet,
        probes: tuple[GripperProbe, ...],
        level: np.ndarray,
        check: GraspCheck,
    ) -> None:
        """Retreat along the approach, which is free, where the way up is not."""
        s = self.settings.check
        for index, probe in enumerate(probes):
            rows = np.flatnonzero((level == index) & check.passed)
            if not len(rows):
                continue
            start = poses.gripper[rows]
            way = poses.retreat[rows, :3, 3] - start[:, :3, 3]
            inside, structure = hits_on_the_way(self.observation, probe, start, way, s)
            blocked = rows[(inside > s.max_approach_inside) | (structure > s.max_structure)]
            poses.retreat[blocked] = poses.approach[blocked]

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

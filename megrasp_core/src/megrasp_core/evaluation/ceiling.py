"""How far a protocol can be passed at all: a planner that knows every object's true geometry and
tries its grasps in simulation before it names one.

Its rate is what no planner that sees one noisy cloud can be expected to beat: where it finds
nothing, the objects that are left lie against walls, under others or too flat on the floor.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.library import ObjectSurface, antipodal
from megrasp_core.objects import ObjectModel
from megrasp_core.pointcloud import Cloud
from megrasp_core.simulation import World, approach_path, judge, start_depths
from megrasp_core.synthesizer import RankedGrasp, Synthesis

from .planners import Planner

GRAVITY = np.array([0.0, 0.0, -1.0])
MAX_DEPTH = 0.001


@dataclass(frozen=True)
class CeilingSettings:
    """Effort of the search, per object and stage.

    candidates: antipodal candidates, half of them within 15 degrees of straight down, half within
    `tilt` (rad). moved: those that collide least are moved at random for `rounds` rounds, by
    `distance` (m) and `angle` (rad), to lessen the collision. tries: free grasps tried.
    approach_distance: m.
    """

    candidates: int = 1000
    tilt: float = float(np.deg2rad(50.0))
    moved: int = 120
    rounds: int = 16
    distance: float = 0.004
    angle: float = 0.06
    tries: int = 15
    approach_distance: float = 0.10


class CeilingPlanner(Planner):
    """Names a grasp only after it has succeeded in a copy of the very state."""

    name = "ceiling"

    def __init__(self, gripper: Gripper, settings: CeilingSettings | None = None) -> None:
        self.gripper = gripper
        self.settings = settings or CeilingSettings()
        self._surfaces: dict[str, ObjectSurface] = {}
        self._stage: tuple[World, dict[int, ObjectModel]] | None = None

    def look_inside(self, world: World, models: Mapping[int, ObjectModel]) -> None:
        """Take the true state in.

        Args:
            world: as the next grasp will find it; left as it is.
            models: of the objects that may be grasped, by place.
        """
        self._stage = world, dict(models)

    def plan(self, cloud: Cloud, **options: Any) -> Synthesis:
        """The first grasp found that succeeds; the cloud is not looked at.

        Raises:
            InvalidRequestError: nobody called `look_inside`.
        """
        if self._stage is None:
            raise InvalidRequestError(
                "the ceiling was asked without a world; expected look_inside first. It works in "
                "simulated protocols only."
            )
        began = time.perf_counter()
        world, goals = self._stage
        rng = np.random.default_rng(options.get("seed"))
        state = world.save()
        found = self._find(world, goals, rng)
        world.restore(state)
        return Synthesis(
            grasps=[] if found is None else [self._grasp(found)],
            rejected={},
            timing={"total": time.perf_counter() - began},
            seed=int(options.get("seed") or 0),
            drawn=int(options.get("drawn", 0)),
            evaluations=0,
            gripper=self.gripper.name,
            model=self.name,
        )

    def _find(
        self, world: World, goals: dict[int, ObjectModel], rng: np.random.Generator
    ) -> np.ndarray | None:
        """Highest objects first; collisions are only repaired where no candidate is free."""
        heights = world.object_poses()[:, 2, 3]
        order = sorted(goals, key=lambda place: -heights[place])
        drawn = {place: self._candidates(world, place, goals[place], rng) for place in order}
        for repair in (False, True):
            for place in order:
                poses = drawn[place]
                depth = start_depths(world, poses)
                if repair:
                    poses, depth = self._moved(world, poses, depth, rng)
                free = poses[depth <= MAX_DEPTH]
                best = self._first_success(world, free[rng.permutation(len(free))], goals)
                if best is not None:
                    return best
        return None

    def _candidates(
        self, world: World, place: int, model: ObjectModel, rng: np.random.Generator
    ) -> np.ndarray:
        if model.name not in self._surfaces:
            self._surfaces[model.name] = ObjectSurface(model)
        world_from_object = world.object_poses()[place]
        down = world_from_object[:3, :3].T @ GRAVITY
        parts = [np.zeros((0, 4, 4))]
        for tilt in (np.deg2rad(15.0), self.settings.tilt):
            found = antipodal(
                model,
                self.gripper,
                self.settings.candidates // 2,
                rng,
                surface=self._surfaces[model.name],
                approach_towards=(down, float(tilt)),
            )
            parts.append(world_from_object @ found.object_from_gripper.reshape(-1, 4, 4))
        return np.concatenate(parts)

    def _moved(
        self, world: World, poses: np.ndarray, depth: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        s = self.settings
        least = np.argsort(depth, kind="stable")[: s.moved]
        poses, depth = poses[least], depth[least]
        for _ in range(s.rounds):
            move = np.tile(np.eye(4), (len(poses), 1, 1))
            move[:, :3, 3] = rng.normal(scale=s.distance, size=(len(poses), 3))
            turn = rng.normal(scale=s.angle, size=(len(poses), 3))
            move[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix().reshape(-1, 3, 3)
            tried = poses @ move
            deeper = start_depths(world, tried)
            better = deeper < depth
            poses[better], depth[better] = tried[better], deeper[better]
        return poses, depth

    def _first_success(
        self, world: World, poses: np.ndarray, goals: Collection[int]
    ) -> np.ndarray | None:
        state, tried = world.save(), 0
        for pose in poses:
            back = self._approach(pose)
            if start_depths(world, approach_path(back, pose)).max() > MAX_DEPTH:
                continue
            verdict = judge(world, pose, graspable=sorted(goals), approach=back)
            world.restore(state)
            if verdict.success:
                return pose
            tried += 1
            if tried >= self.settings.tries:
                return None
        return None

    def _approach(self, pose: np.ndarray) -> np.ndarray:
        back = pose.copy()
        back[:3, 3] -= self.settings.approach_distance * pose[:3, 2]
        return back

    def _grasp(self, pose: np.ndarray) -> RankedGrasp:
        tilt = float(np.arccos(np.clip(pose[:3, 2] @ GRAVITY, -1.0, 1.0)))
        tcp = pose @ np.asarray(self.gripper.gripper_from_tcp)
        nan = float("nan")
        back = self._approach(pose)
        return RankedGrasp(tcp, pose, back, back, 1.0, nan, nan, tilt, True)

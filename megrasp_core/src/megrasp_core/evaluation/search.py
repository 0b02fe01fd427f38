"""Search for a grasp by one who knows every object's true geometry and tries each grasp in
simulation.

Not complete: a grasp beyond its candidates may exist.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import Gripper
from megrasp_core.library import ObjectSurface, antipodal
from megrasp_core.objects import ObjectModel
from megrasp_core.simulation import START_DEPTH, World, approach_path, judge, start_depths

GRAVITY = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class SearchSettings:
    """Effort of the search, per object.

    candidates: antipodal candidates, those of a hand from opposing finger groups; half of them
    within 15 degrees of straight down, half within `tilt` (rad). moved: those that collide least
    are moved at random for `rounds` rounds, by `distance` (m) and `angle` (rad), to lessen the
    collision. tries: free grasps tried. approach_distance: m.
    """

    candidates: int = 1000
    tilt: float = float(np.deg2rad(50.0))
    moved: int = 120
    rounds: int = 16
    distance: float = 0.004
    angle: float = 0.06
    tries: int = 15
    approach_distance: float = 0.10


class GraspSearch:
    """Grasps of one gripper that have succeeded in a copy of the very state."""

    def __init__(self, gripper: Gripper, settings: SearchSettings | None = None) -> None:
        self.gripper = gripper
        self.settings = settings or SearchSettings()
        self._surfaces: dict[str, ObjectSurface] = {}

    def find(
        self, world: World, goals: Mapping[int, ObjectModel], rng: np.random.Generator
    ) -> np.ndarray | None:
        """A pre-grasp (4, 4) of the gripper frame that lifts one of the goals; None: none found.

        Highest objects first; collisions are only repaired where no candidate is free.

        Args:
            world: the state, as it is again afterwards.
            goals: objects that may be lifted, by place.
            rng: of candidates and repairs.
        """
        state = world.save()
        try:
            return self._find(world, goals, rng)
        finally:
            world.restore(state)

    def reachable(
        self, world: World, goals: Mapping[int, ObjectModel], rng: np.random.Generator
    ) -> set[int]:
        """Those of the goals that a grasp is found for, each searched by itself."""
        return {
            place
            for place, model in goals.items()
            if self.find(world, {place: model}, rng) is not None
        }

    def stand_off(self, pose: np.ndarray) -> np.ndarray:
        """Where the gripper comes from."""
        back = pose.copy()
        back[:3, 3] -= self.settings.approach_distance * pose[:3, 2]
        return back

    def _find(
        self, world: World, goals: Mapping[int, ObjectModel], rng: np.random.Generator
    ) -> np.ndarray | None:
        heights = world.object_poses()[:, 2, 3]
        order = sorted(goals, key=lambda place: -heights[place])
        drawn = {place: self._candidates(world, place, goals[place], rng) for place in order}
        for repair in (False, True):
            for place in order:
                poses = drawn[place]
                depth = start_depths(world, poses)
                if repair:
                    poses, depth = self._moved(world, poses, depth, rng)
                free = poses[depth <= START_DEPTH]
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
            back = self.stand_off(pose)
            if start_depths(world, approach_path(back, pose)).max() > START_DEPTH:
                continue
            verdict = judge(world, pose, graspable=sorted(goals), approach=back)
            world.restore(state)
            if verdict.success:
                return pose
            tried += 1
            if tried >= self.settings.tries:
                return None
        return None

"""Grasps proposed in a settled scene: library grasps taken in, fresh ones, and which of them are
free of collision.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import Gripper
from megrasp_core.library import GraspLibrary, ObjectSurface, antipodal
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectSet
from megrasp_core.pointcloud import grown_region
from megrasp_core.simulation import (
    START_DEPTH,
    Reason,
    World,
    approach_path,
    build_world,
    start_depths,
)

from .layout import GRAVITY, Layout, SceneConfig

Poses = NDArray[np.float64]


@dataclass(frozen=True)
class SceneGrasps:
    """Grasps of one gripper in one scene, n rows each.

    Symmetric copies of one grasp share their `group`: they are tested for collision one by one and
    tried once.

    Attributes:
        pose: (n, 4, 4) `world_from_tcp`.
        object: (n,) object each was made for.
        reason: (n,) "" for free grasps, else the collision.
        library: (n,) whether it comes from the library.
        group: (n,) number of the grasp that this is a copy of.
    """

    pose: Poses
    object: NDArray[np.int64]
    reason: NDArray[np.str_]
    library: NDArray[np.bool_]
    group: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.object)

    @staticmethod
    def untested(pose: Poses, owner: NDArray[np.integer], library: bool) -> SceneGrasps:
        """Grasps without copies that nobody has tested yet."""
        count = len(owner)
        return SceneGrasps(
            pose.reshape(-1, 4, 4),
            owner.astype(np.int64),
            np.full(count, "", dtype="<U20"),
            np.full(count, library),
            np.arange(count),
        )

    def part(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> SceneGrasps:
        """The rows of `index`."""
        return SceneGrasps(
            self.pose[index],
            self.object[index],
            self.reason[index],
            self.library[index],
            self.group[index],
        )

    def followed_by(self, other: SceneGrasps) -> SceneGrasps:
        """Both, one after another; the other's groups get new numbers."""
        shift = int(self.group.max(initial=-1)) + 1
        return SceneGrasps(
            np.concatenate([self.pose, other.pose]),
            np.concatenate([self.object, other.object]),
            np.concatenate([self.reason, other.reason]),
            np.concatenate([self.library, other.library]),
            np.concatenate([self.group, other.group + shift]),
        )


class SceneProposer:
    """Proposes grasps of one gripper in one settled scene and tests them for collision.

    Args:
        layout: the settled scene.
        gripper: the gripper.
        library: free-space grasps.
        objects: models by name.
        config: amounts and limits.

    Attributes:
        world: the scene with the gripper, as settled.
        graspable: indices of the objects that may be grasped.
    """

    def __init__(
        self,
        layout: Layout,
        gripper: Gripper,
        library: GraspLibrary,
        objects: ObjectSet,
        config: SceneConfig,
    ) -> None:
        self._layout, self._gripper, self._library = layout, gripper, library
        self._objects, self._config = objects, config
        obstacles = set(np.flatnonzero(layout.obstacle).tolist())
        self.graspable = [i for i in range(len(layout.object_names)) if i not in obstacles]
        self.world: World = build_world(
            [objects[name] for name in layout.object_names],
            gripper=gripper,
            bin=layout.bin,
            obstacles=obstacles,
            object_poses=layout.matrices,
            visual=False,
        )
        if config.sleep:
            self.world.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        self._surfaces: dict[str, ObjectSurface] = {}
        self.tcp_from_gripper = gripper.tcp_from_gripper

    def library_grasps(self, rng: np.random.Generator) -> SceneGrasps:
        """Successful library grasps of every graspable object, not yet tested."""
        poses: list[Poses] = []
        owners: list[int] = []
        for index in self.graspable:
            entry = self._library.get(self._gripper.name, self._layout.object_names[index])
            if entry is None or not entry.success.any():
                continue
            object_from_tcp = np.asarray(matrix_from_pose7(entry.successes))
            chosen = rng.permutation(len(object_from_tcp))[: self._config.tested_per_object]
            poses.append(self._layout.matrices[index] @ object_from_tcp[chosen])
            owners.append(index)
        return self._with_copies(poses, owners, library=True)

    def proposals(self, rng: np.random.Generator) -> SceneGrasps:
        """Library and fresh grasps, tested; objects with few free ones get more fresh ones for
        some rounds.

        A test costs a thousandth of a trial, so it is the proposals that are plentiful.
        """
        config = self._config
        tested = self.tested(self.library_grasps(rng))
        for round_number in range(config.fresh_rounds):
            free = tested.object[tested.reason == ""]
            wanted = [
                index
                for index in self.graspable
                if round_number == 0 or (free == index).sum() < config.free_wanted
            ]
            tested = tested.followed_by(self.tested(self.fresh_grasps(rng, wanted)))
        return tested

    def fresh_grasps(self, rng: np.random.Generator, wanted: list[int]) -> SceneGrasps:
        """New steep candidates on the objects `wanted`: few library grasps are within reach in a
        heap.
        """
        poses: list[Poses] = []
        owners: list[int] = []
        for index in wanted if self._config.fresh else []:
            world_from_object = self._layout.matrices[index]
            down = world_from_object[:3, :3].T @ np.array(GRAVITY)
            candidates = antipodal(
                self._objects[self._layout.object_names[index]],
                self._gripper,
                self._config.fresh,
                rng,
                settings=self._config.candidates,
                surface=self._surface(index),
                approach_towards=(down, min(self.tilt_limit, self._config.fresh_tilt)),
            )
            in_world = world_from_object @ candidates.object_from_gripper
            poses.append(in_world @ self._gripper.gripper_from_tcp)
            owners.append(index)
        return self._with_copies(poses, owners, library=False)

    def _surface(self, index: int) -> ObjectSurface:
        name = self._layout.object_names[index]
        if name not in self._surfaces:
            self._surfaces[name] = ObjectSurface(self._objects[name])
        return self._surfaces[name]

    @property
    def tilt_limit(self) -> float:
        """Steepest approach against straight down (rad)."""
        config = self._config
        return config.tilt_table if self._layout.bin is None else config.tilt_bin

    def tested(self, grasps: SceneGrasps) -> SceneGrasps:
        """The grasps with their reason: "" for free ones, else what is in the way."""
        if not len(grasps):
            return grasps
        pose = grasps.pose @ self.tcp_from_gripper
        reason = grasps.reason.copy()
        reason[start_depths(self.world, pose) > START_DEPTH] = Reason.START_COLLISION.value
        if self._layout.bin is not None:
            back = np.eye(4)
            back[2, 3] = -self._config.approach
            for index in np.flatnonzero(reason == ""):
                path = approach_path(pose[index] @ back, pose[index])
                if start_depths(self.world, path).max() > START_DEPTH:
                    reason[index] = Reason.APPROACH_COLLISION.value
        return replace(grasps, reason=reason)

    def _with_copies(self, poses: list[Poses], owners: list[int], *, library: bool) -> SceneGrasps:
        """The poses with their symmetric copies, without those that are too steep or out of the
        region.
        """
        pose = np.concatenate([np.zeros((0, 4, 4)), *poses])
        owner = np.repeat(np.array(owners, np.int64), [len(part) for part in poses])
        fold = max(1, int(self._gripper.description.symmetry))
        turns = np.tile(np.eye(4), (fold, 1, 1))
        turns[:, :3, :3] = Rotation.from_rotvec(
            np.outer(np.arange(fold) * 2 * np.pi / fold, [0.0, 0.0, 1.0])
        ).as_matrix()
        copies = SceneGrasps.untested(pose[:, None] @ turns[None], np.repeat(owner, fold), library)
        copies = replace(copies, group=np.repeat(np.arange(len(pose)), fold))
        return copies.part(self._admitted(copies.pose))

    def _admitted(self, world_from_tcp: Poses) -> NDArray[np.bool_]:
        """Which poses are within the tilt limit and have their TCP where the camera's cloud is
        kept.
        """
        steepness = world_from_tcp[:, :3, 2] @ np.array(GRAVITY)
        seen = grown_region(
            self._layout.region, np.array(GRAVITY), np.zeros(3), self._config.surface
        )
        return (steepness >= np.cos(self.tilt_limit)) & seen.contains(world_from_tcp[:, :3, 3])

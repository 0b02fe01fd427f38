"""Labels of one gripper in a settled scene: library grasps taken in, collisions, trials in the heap (DESIGN section 5)."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.datasets.candidates import antipodal
from megrasp_core.datasets.layout import GRAVITY, LABELS, Layout, SceneConfig, stream
from megrasp_core.datasets.library import GraspLibrary
from megrasp_core.datasets.object_set import ObjectSet
from megrasp_core.datasets.records import GripperLabels, Kind
from megrasp_core.grippers import Gripper
from megrasp_core.lie.pose import matrix_from_pose7, pose7_from_matrix
from megrasp_core.pointcloud import grown_region
from megrasp_core.simulation import World, approach_path, build_world, judge, start_depths

MAX_DEPTH = 0.001
"""Deepest penetration that still counts as free (m), as in the verdict."""

_Poses = NDArray[np.float64]


@dataclass
class _Tested:
    """Grasps of a scene after the collision test: `world_from_tcp` (n, 4, 4) and one row each below.

    Symmetric copies of one grasp share their `group`: they are tested for collision one by one and tried once.
    """

    pose: _Poses
    object: NDArray[np.int64]
    reason: NDArray[np.str_]
    library: NDArray[np.bool_]
    group: NDArray[np.int64]

    def part(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> _Tested:
        return _Tested(
            self.pose[index],
            self.object[index],
            self.reason[index],
            self.library[index],
            self.group[index],
        )


class SceneLabeller:
    """Labels one settled scene for one gripper.

    Args:
        layout: the settled scene.
        gripper: the gripper.
        library: free-space grasps.
        objects: models by name.
        seed: of the scene.
        config: amounts and limits.
    """

    def __init__(
        self,
        layout: Layout,
        gripper: Gripper,
        library: GraspLibrary,
        objects: ObjectSet,
        seed: int,
        config: SceneConfig,
    ) -> None:
        self._layout, self._gripper, self._library = layout, gripper, library
        self._objects, self._config = objects, config
        self._rng = stream(seed, LABELS, zlib.crc32(gripper.name.encode()))
        models = [objects[name] for name in layout.object_names]
        self._obstacles = set(np.flatnonzero(layout.obstacle).tolist())
        self._graspable = [i for i in range(len(models)) if i not in self._obstacles]
        self._world: World = build_world(
            models,
            gripper=gripper,
            bin=layout.bin,
            obstacles=self._obstacles,
            object_poses=layout.matrices,
            visual=False,
        )
        if config.sleep:
            self._world.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        self._start = self._world.save()
        self._groups = 0
        self._tcp_from_gripper = np.linalg.inv(gripper.gripper_from_tcp)

    def labels(self) -> GripperLabels:
        """All labels of the gripper in the scene."""
        config = self._config
        tested = _joined(
            [self._tested(self._library_poses()), self._tested(self._fresh_poses())]
        )
        free = self._capped(tested.part(tested.reason == ""))
        _, first = np.unique(free.group, return_index=True)
        trials = first[self._balanced(free.object[first])][: config.judged]
        judged = self._judged(free.part(trials), Kind.JUDGED)
        rest = free.part(free.library & ~np.isin(free.group, free.group[trials]))
        positives = judged.label == 1
        colliding = tested.part(tested.reason != "")
        colliding = colliding.part(self._balanced(colliding.object)[: config.colliding])
        return GripperLabels.joined(
            [
                judged,
                _inherited(free, trials, judged),
                _labels(rest.pose, rest.object, 1, Kind.LIBRARY, np.full(len(rest.object), "")),
                self._perturbed(
                    np.asarray(matrix_from_pose7(judged.world_from_tcp[positives])),
                    judged.object[positives],
                ),
                _labels(colliding.pose, colliding.object, 0, Kind.COLLISION, colliding.reason),
            ]
        )

    def _library_poses(self) -> _Tested:
        """Successful library grasps of every graspable object with their symmetric copies, steep ones dropped."""
        poses: list[_Poses] = []
        owners: list[int] = []
        for index in self._graspable:
            entry = self._library.get(self._gripper.name, self._layout.object_names[index])
            if entry is None or not entry.success.any():
                continue
            object_from_tcp = np.asarray(matrix_from_pose7(entry.successes))
            chosen = self._rng.permutation(len(object_from_tcp))[: self._config.tested_per_object]
            poses.append(self._layout.matrices[index] @ object_from_tcp[chosen])
            owners.append(index)
        return self._untested(poses, owners, library=True)

    def _fresh_poses(self) -> _Tested:
        """New steep candidates on every graspable object: few library grasps are within reach in a heap."""
        poses: list[_Poses] = []
        owners: list[int] = []
        for index in self._graspable if self._config.fresh else []:
            world_from_object = self._layout.matrices[index]
            down = world_from_object[:3, :3].T @ np.array(GRAVITY)
            candidates = antipodal(
                self._objects[self._layout.object_names[index]],
                self._gripper,
                self._config.fresh,
                self._rng,
                settings=self._config.candidates,
                approach_towards=(down, min(self._tilt_limit, self._config.fresh_tilt)),
            )
            in_world = world_from_object @ candidates.object_from_gripper
            poses.append(in_world @ self._gripper.gripper_from_tcp)
            owners.append(index)
        return self._untested(poses, owners, library=False)

    def _inherited(
    free: _Tested, trials: NDArray[np.integer], judged: GripperLabels
) -> GripperLabels:
    """Labels of the free symmetric copies of tried grasps: those of the grasp that was tried."""
    position = {int(group): index for index, group in enumerate(free.group[trials])}
    copies = np.setdiff1d(np.flatnonzero(np.isin(free.group, free.group[trials])), trials)
    source = np.array([position[int(free.group[index])] for index in copies], np.int64)
    return _labels(
        free.pose[copies],
        judged.object[source],
        judged.label[source],
        Kind.JUDGED,
        judged.reason[source],
    )


def _joined(parts: list[_Tested]) -> _Tested:
    return _Tested(
        np.concatenate([p.pose for p in parts]),
        np.concatenate([p.object for p in parts]),
        np.concatenate([p.reason for p in parts]),
        np.concatenate([p.library for p in parts]),
        np.concatenate([p.group for p in parts]),
    )


def _labels(
    pose: _Poses,
    owner: NDArray[np.integer],
    label: int | NDArray[np.int8],
    kind: Kind,
    reason: NDArray[np.str_],
) -> GripperLabels:
    count = len(owner)
    return GripperLabels(
        np.asarray(pose7_from_matrix(pose), np.float32).reshape(-1, 7),
        owner.astype(np.int16),
        np.broadcast_to(np.asarray(label, np.int8), (count,)).copy(),
        np.full(count, int(kind), np.int8),
        reason,
    )

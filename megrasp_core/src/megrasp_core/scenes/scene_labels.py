"""Labels of one gripper in a settled scene: which free grasps hold when tried in the heap."""

from __future__ import annotations

import zlib

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import Gripper
from megrasp_core.library import GraspLibrary
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectSet
from megrasp_core.simulation import judge
from megrasp_core.storage import GripperLabels, Kind

from .layout import LABELS, Layout, SceneConfig, stream
from .scene_grasps import Poses, SceneGrasps, SceneProposer

NEAR_METRES = (0.002, 0.010)
NEAR_RADIANS = (0.05, 0.3)
"""Least and largest move of a near miss."""


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
        self._config = config
        self._rng = stream(seed, LABELS, zlib.crc32(gripper.name.encode()))
        self._proposer = SceneProposer(layout, gripper, library, objects, config)
        self._world = self._proposer.world
        self._start = self._world.save()

    def labels(self) -> GripperLabels:
        """All labels of the gripper in the scene."""
        config, proposer = self._config, self._proposer
        tested = proposer.proposals(self._rng)
        free = self._capped(tested.part(tested.reason == ""))
        _, first = np.unique(free.group, return_index=True)
        order = first[balanced(free.object[first], self._rng)]
        more = order[config.judged :]
        more = more[free.library[more]][: config.judged_library]
        trials = np.concatenate([order[: config.judged], more])
        judged = self._judged(free.part(trials), Kind.JUDGED)
        held = judged.label == 1
        colliding = tested.part(tested.reason != "")
        colliding = colliding.part(balanced(colliding.object, self._rng)[: config.colliding])
        return GripperLabels.joined(
            [
                judged,
                _inherited(free, trials, judged),
                self._perturbed(
                    np.asarray(matrix_from_pose7(judged.world_from_tcp[held])),
                    judged.object[held],
                ),
                GripperLabels.of(
                    colliding.pose,
                    object=colliding.object,
                    label=0,
                    kind=Kind.COLLISION,
                    reason=colliding.reason,
                ),
            ]
        )

    def _capped(self, free: SceneGrasps) -> SceneGrasps:
        """At most `kept_per_object` grasps of an object, whatever they come from."""
        keep = [
            self._rng.permutation(np.flatnonzero(free.object == index))[
                : self._config.kept_per_object
            ]
            for index in self._proposer.graspable
        ]
        return free.part(np.concatenate([np.zeros(0, np.int64), *keep]))

    def _judged(self, grasps: SceneGrasps, kind: Kind) -> GripperLabels:
        label = np.zeros(len(grasps), np.int8)
        reason = np.full(len(grasps), "", dtype="<U20")
        extra = GripperLabels.not_tried(len(grasps))
        owner = grasps.object.copy()
        for index, pose in enumerate(grasps.pose):
            self._reset()
            verdict = judge(
                self._world,
                pose @ self._proposer.tcp_from_gripper,
                graspable=self._proposer.graspable,
            )
            label[index] = verdict.success
            reason[index] = "" if verdict.success else verdict.reason.value
            extra[index] = verdict.extra
            if verdict.success and verdict.target is not None:
                owner[index] = verdict.target
        self._reset()
        return GripperLabels.of(
            grasps.pose, object=owner, label=label, kind=kind, reason=reason, extra=extra
        )

    def _reset(self) -> None:
        """Back to the settled scene, nothing asleep: a trial must not depend on the one before."""
        mujoco.mj_resetData(self._world.model, self._world.data)
        self._world.restore(self._start)

    def _perturbed(self, positives: Poses, owners: NDArray[np.integer]) -> GripperLabels:
        """Moves some judged positives a little and tries them again: labels near the edge of
        success.
        """
        count = min(self._config.perturbed, len(positives))
        chosen = self._rng.permutation(len(positives))[:count]
        move = near_moves(count, self._rng)
        tested = self._proposer.tested(
            SceneGrasps.untested(positives[chosen] @ move, owners[chosen], library=False)
        )
        free = tested.reason == ""
        hit = tested.part(~free)
        return GripperLabels.joined(
            [
                self._judged(tested.part(free), Kind.PERTURBED),
                GripperLabels.of(
                    hit.pose, object=hit.object, label=0, kind=Kind.PERTURBED, reason=hit.reason
                ),
            ]
        )


def balanced(owners: NDArray[np.integer], rng: np.random.Generator) -> NDArray[np.int64]:
    """An order (n,) of grasps of the objects `owners` (n,) in which the objects take turns, drawn
    anew for every round.
    """
    rank = np.zeros(len(owners))
    for index in np.unique(owners):
        mine = np.flatnonzero(owners == index)
        rank[mine] = rng.permutation(len(mine))
    return np.lexsort((rng.random(len(owners)), rank))


def near_moves(count: int, rng: np.random.Generator) -> Poses:
    """Moves (n, 4, 4) in the TCP frame by lengths and angles even over `NEAR_METRES` and
    `NEAR_RADIANS`, each in any direction: from where most grasps still hold to where most fail.
    """
    move = np.tile(np.eye(4), (count, 1, 1))
    axes = rng.normal(size=(2, count, 3))
    axes /= np.maximum(np.linalg.norm(axes, axis=2, keepdims=True), 1e-12)
    move[:, :3, 3] = axes[0] * rng.uniform(*NEAR_METRES, size=(count, 1))
    if count:
        turn = axes[1] * rng.uniform(*NEAR_RADIANS, size=(count, 1))
        move[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return move


def _inherited(
    free: SceneGrasps, trials: NDArray[np.integer], judged: GripperLabels
) -> GripperLabels:
    """Labels of the free symmetric copies of tried grasps: those of the grasp that was tried."""
    position = {int(group): index for index, group in enumerate(free.group[trials])}
    copies = np.setdiff1d(np.flatnonzero(np.isin(free.group, free.group[trials])), trials)
    source = np.array([position[int(free.group[index])] for index in copies], np.int64)
    return GripperLabels.of(
        free.pose[copies],
        object=judged.object[source],
        label=judged.label[source],
        kind=Kind.JUDGED,
        reason=judged.reason[source],
        extra=judged.extra[source],
    )

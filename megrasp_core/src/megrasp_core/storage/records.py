"""The records that the generator makes: labels of one object, labels of one scene.

Poses are `world_from_tcp` (or `object_from_tcp`) as seven numbers [x, y, z, qx, qy, qz, qw],
metres; the TCP frame has +Z as approach and +X as closing axis.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.lie import pose7_from_matrix
from megrasp_core.pointcloud import (
    SceneNodes,
    SceneSettings,
    SurfaceCloud,
    choose_nodes,
    node_counts,
    nodes_at,
)
from megrasp_core.simulation import Bin


class Kind(IntEnum):
    """Where a scene's label comes from."""

    LIBRARY = 0
    """Held in the free-space trial, free of collision in the scene; not tried in the heap. Only in
    older scenes: now every success is one that was tried.
    """
    JUDGED = 1
    """Tried in the heap by `simulation.judge`."""
    COLLISION = 2
    """The open gripper touches something at the pre-grasp or on the approach."""
    PERTURBED = 3
    """A positive, moved a little and tried in the heap."""
    SAMPLED = 4
    """Drawn by a model and tried in the heap."""


@dataclass(frozen=True)
class GraspSet:
    """Labels of one object for one gripper from the free-space trial.

    Attributes:
        gripper: name of the gripper.
        gripper_hash: hash of the description that the labels belong to.
        object_name: name of the object in its object set.
        object_from_tcp: (n, 7) float64 poses.
        success: (n,) bool, held through the shaking.
        quality: (n,) float32 from 0, lost, to 1, did not move in the hand while shaken.
        reason: (n,) str, why a trial failed; "" for successes.
        drawn: grasps drawn in all, start collisions included.
        tried: full trials among them.
    """

    gripper: str
    gripper_hash: str
    object_name: str
    object_from_tcp: NDArray[np.float64]
    success: NDArray[np.bool_]
    quality: NDArray[np.float32]
    reason: NDArray[np.str_]
    drawn: int
    tried: int

    @property
    def successes(self) -> NDArray[np.float64]:
        """(k, 7) poses of the successful grasps."""
        return self.object_from_tcp[self.success]


NOT_TRIED = -1
"""As `GripperLabels.extra`: it was not tried in the heap, or what rose was not kept. As
`GripperLabels.robust`: it was not tried again under other conditions.
"""

ROBUST_TRIALS = 4
"""So often a grasp is tried again for its robust label."""


@dataclass(frozen=True, kw_only=True)
class GripperLabels:
    """Labels of one gripper in one scene.

    Attributes:
        world_from_tcp: (K, 7) float32 poses of the TCP at the pre-grasp.
        object: (K,) int16, the object the grasp was made for (index into the scene's objects).
        label: (K,) int8, 1 success, 0 failure.
        kind: (K,) int8, a `Kind`.
        reason: (K,) str, why it failed; "" for successes.
        extra: (K,) int8, objects lifted besides the target (`Verdict.extra`), or NOT_TRIED.
        robust: (K,) int8, how many of ROBUST_TRIALS under other conditions it held
            (`scenes/robust.py`), or NOT_TRIED.
    """

    world_from_tcp: NDArray[np.float32]
    object: NDArray[np.int16]
    label: NDArray[np.int8]
    kind: NDArray[np.int8]
    reason: NDArray[np.str_]
    extra: NDArray[np.int8]
    robust: NDArray[np.int8]

    @classmethod
    def of(
        cls,
        world_from_tcp: NDArray[np.floating],
        *,
        object: ArrayLike,
        label: ArrayLike,
        kind: Kind,
        reason: ArrayLike,
        extra: ArrayLike = NOT_TRIED,
        robust: ArrayLike = NOT_TRIED,
    ) -> GripperLabels:
        """Labels of K grasps; what is given besides the poses is of length K, or one for all.

        Args:
            world_from_tcp: (K, 4, 4) or (K, 7) poses of the TCP at the pre-grasp.
            object: index into the scene's objects.
            label: 1 success, 0 failure.
            kind: of all of them.
            reason: why it failed; "" for successes.
            extra: objects lifted besides the target, or NOT_TRIED.
            robust: how many of ROBUST_TRIALS it held, or NOT_TRIED.

        Raises:
            ValueError: a length is another one.
        """
        poses = np.asarray(world_from_tcp)
        if poses.ndim == 3:
            poses = np.asarray(pose7_from_matrix(poses)).reshape(-1, 7)
        count = len(poses)

        def filled(value: ArrayLike, dtype: type[np.generic]) -> NDArray[Any]:
            return np.broadcast_to(np.asarray(value, dtype), (count,)).copy()

        return cls(
            world_from_tcp=poses.astype(np.float32),
            object=filled(object, np.int16),
            label=filled(label, np.int8),
            kind=filled(int(kind), np.int8),
            reason=filled(reason, np.str_),
            extra=filled(extra, np.int8),
            robust=filled(robust, np.int8),
        )

    def __len__(self) -> int:
        return len(self.label)

    @property
    def target(self) -> NDArray[np.float32]:
        """(K,) float32 in [0, 1], what a confidence should say: the share of the robust trials
        that held, where there were any, else the label.
        """
        share = self.robust.astype(np.float32) / np.float32(ROBUST_TRIALS)
        return np.where(self.robust == NOT_TRIED, self.label, share).astype(np.float32)

    def part(self, index: NDArray[np.integer] | NDArray[np.bool_] | slice) -> GripperLabels:
        """The rows of `index`."""
        return GripperLabels(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @classmethod
    def empty(cls) -> GripperLabels:
        """No label at all."""
        return cls.of(np.zeros((0, 7)), object=0, label=0, kind=Kind.JUDGED, reason="")

    @classmethod
    def joined(cls, parts: list[GripperLabels]) -> GripperLabels:
        """The labels of `parts`, one after another."""
        if not parts:
            return cls.empty()
        return cls(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)}
        )

    @staticmethod
    def not_tried(count: int) -> NDArray[np.int8]:
        """(count,) NOT_TRIED, as `extra` and `robust`."""
        return np.full(count, NOT_TRIED, np.int8)


@dataclass(frozen=True)
class SceneRecord:
    """One settled scene, what the camera saw of it, and the labels of every gripper.

    Attributes:
        name: unique within a data set, made from the seed.
        seed: the seed that makes this scene again.
        object_names: n names in the object set.
        object_poses: (n, 7) float32 `world_from_object`.
        obstacle: (n,) bool, objects that must not be lifted.
        bin: None for a table.
        points: (M, 3) float16 preprocessed surface points in the world frame.
        normals: (M, 3) int8, 127 times the unit normal.
        on_plane: (M,) bool, points of the support plane.
        sensor: (3,) float32 position of the camera.
        gravity: (3,) float32 unit vector.
        labels: gripper name -> labels.
    """

    name: str
    seed: int
    object_names: tuple[str, ...]
    object_poses: NDArray[np.float32]
    obstacle: NDArray[np.bool_]
    bin: Bin | None
    points: NDArray[np.float16]
    normals: NDArray[np.int8]
    on_plane: NDArray[np.bool_]
    sensor: NDArray[np.float32]
    gravity: NDArray[np.float32]
    labels: dict[str, GripperLabels] = field(default_factory=dict)

    def surface(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (M, 3) and unit normals (M, 3) in float64, as stored."""
        normals = self.normals.astype(np.float64)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return self.points.astype(np.float64), normals

    def without_labels(self) -> SceneRecord:
        """The scene with its surface alone."""
        return replace(self, labels={})

    def surface_cloud(self) -> SurfaceCloud:
        """The surface as preprocessing left it."""
        points, normals = self.surface()
        return SurfaceCloud(
            points=points,
            normals=normals,
            on_plane=self.on_plane,
            sensor=self.sensor.astype(np.float64),
            gravity=self.gravity.astype(np.float64),
            crop=points,
            region=None,
        )

    def chosen(self, settings: SceneSettings, seed: int = 0) -> NDArray[np.intp]:
        """Which points of the surface are nodes: seed 0 chooses as at inference, another one at
        random.
        """
        counts = node_counts(self.on_plane, settings)
        return choose_nodes(self.points.astype(np.float64), self.on_plane, counts, seed)

    def nodes(self, settings: SceneSettings, seed: int = 0) -> SceneNodes:
        """Nodes for the network: seed 0 gives those of inference, another one a random choice."""
        return nodes_at(self.surface_cloud(), self.chosen(settings, seed))


def bin_fields(bin: Bin | None) -> dict[str, Any] | None:
    """A bin as JSON; back with `bin_from_fields`."""
    return None if bin is None else asdict(bin)


def bin_from_fields(value: Any) -> Bin | None:
    """The bin of `bin_fields`, or of what the first format kept of one: its inner size alone."""
    if value is None:
        return None
    if not isinstance(value, dict):
        return Bin(tuple(value))
    return Bin(tuple(value["inner"]), value["wall"], tuple(value["tilt"]), tuple(value["colour"]))


def pack_normals(normals: NDArray[np.floating]) -> NDArray[np.int8]:
    """Unit normals (M, 3) -> int8, 127 times each; the direction error stays below 0.4 degrees."""
    return np.clip(np.rint(normals * 127.0), -127, 127).astype(np.int8)

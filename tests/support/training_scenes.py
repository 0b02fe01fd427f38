"""Small scenes on disk to train on, without physics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.storage import GripperLabels, Kind, SceneRecord, SceneWriter

GRIPPER = "robotiq_2f85"
TRIED, HELD = 30, 20
"""Labels a gripper; the first HELD of them held."""


def labels(seed: int, owners: int = 2) -> GripperLabels:
    """TRIED labels on the cube's face, two on object 0 and the rest spread over the others."""
    rng = np.random.default_rng(seed)
    where = rng.uniform(-0.05, 0.05, (TRIED, 3))
    turn = Rotation.random(TRIED, random_state=seed).as_quat()
    number = np.arange(TRIED)
    owner = np.where(number < 2, 0, 1 + number % max(1, owners - 1))
    return GripperLabels.of(
        np.hstack([where, turn]),
        object=np.minimum(owner, owners - 1),
        label=number < HELD,
        kind=Kind.LIBRARY,
        reason="",
        extra=0,
    )


def record(
    seed: int,
    *,
    grippers: Iterable[str] = (GRIPPER,),
    objects: tuple[str, ...] = ("a", "b"),
) -> SceneRecord:
    """Points on a 10 cm cube face with grasps of every gripper."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.05, 0.05, (400, 3))
    points[:, 2] = 0.05
    return SceneRecord(
        name=f"scene_{seed:010d}",
        seed=seed,
        object_names=objects,
        object_poses=np.zeros((len(objects), 7), np.float32),
        obstacle=np.zeros(len(objects), bool),
        bin=None,
        points=points.astype(np.float16),
        normals=np.tile([0, 0, 127], (400, 1)).astype(np.int8),
        on_plane=np.zeros(400, bool),
        sensor=np.array([0, 0, 0.8], np.float32),
        gravity=np.array([0, 0, -1], np.float32),
        labels={
            name: labels(seed + 100 * place, len(objects)) for place, name in enumerate(grippers)
        },
    )


def written(folder: Path, records: Iterable[SceneRecord]) -> Path:
    """A data set folder of these scenes."""
    writer = SceneWriter(folder, {"config": "test"})
    for scene in records:
        writer.add(scene)
    writer.close()
    return folder

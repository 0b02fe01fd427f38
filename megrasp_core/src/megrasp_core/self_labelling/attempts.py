"""Attempts of a real cell as scenes, from which the confidence of a model learns."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from megrasp_core.errors import DataError, MegraspError
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.pointcloud import Cloud, SceneSettings, surface_cloud
from megrasp_core.storage import (
    Attempt,
    GripperLabels,
    Kind,
    SceneRecord,
    SceneWriter,
    pack_normals,
    scene_name,
)

log = logging.getLogger(__name__)


def attempt_scene(attempt: Attempt, settings: SceneSettings | None = None) -> SceneRecord:
    """The scene of an attempt with one label, moved so that its middle is at the origin.

    There float16 keeps tenths of a millimetre, wherever the cell's frame lies. The one object is
    the attempt itself: a tenth of them, by the hash of their names, validates.

    Raises:
        CloudError, EmptyRegionError: nothing of the cloud is of use.
    """
    surface = surface_cloud(
        Cloud(attempt.points),
        sensor=attempt.sensor,
        gravity=attempt.gravity,
        region=attempt.region,
        settings=settings,
    )
    middle = surface.points.mean(axis=0)
    tcp = attempt.world_from_tcp.copy()
    tcp[:3, 3] -= middle
    gravity = np.zeros(3) if surface.gravity is None else surface.gravity
    return SceneRecord(
        name=scene_name(attempt.time),
        seed=attempt.time,
        object_names=(f"attempt_{attempt.time}",),
        object_poses=np.array([pose7_from_matrix(tcp)], np.float32),
        obstacle=np.zeros(1, bool),
        bin=None,
        points=(surface.points - middle).astype(np.float16),
        normals=pack_normals(surface.normals),
        on_plane=surface.on_plane,
        sensor=(surface.sensor - middle).astype(np.float32),
        gravity=gravity.astype(np.float32),
        labels={
            attempt.gripper: GripperLabels.of(
                tcp[None],
                object=0,
                label=int(attempt.success),
                kind=Kind.SAMPLED,
                reason=attempt.reason,
            )
        },
    )


def write_attempt_scenes(
    attempts: Iterable[Attempt], out: Path, notes: list[str]
) -> tuple[np.ndarray, list[str]]:
    """Add attempts to a data set folder, those that it does not hold yet.

    Args:
        attempts: each is looked at once.
        out: data set folder.
        notes: gets a sentence for each attempt that is of no use.

    Returns:
        The outcomes (N,) bool of those in the folder, and the names of their grippers.
    """
    writer = SceneWriter(out, {"made_by": "attempts"})
    outcomes: list[bool] = []
    hashes: dict[str, str] = {}
    try:
        for attempt in attempts:
            try:
                _require_same_gripper(attempt, hashes)
                if attempt.time not in writer:
                    writer.add(attempt_scene(attempt))
            except MegraspError as error:
                notes.append(f"attempt {attempt.time} left out: {error}")
                continue
            outcomes.append(attempt.success)
    finally:
        writer.close()
    return np.array(outcomes, dtype=bool), sorted(hashes)


def _require_same_gripper(attempt: Attempt, hashes: dict[str, str]) -> None:
    name = attempt.gripper
    if name not in hashes:
        hashes[name] = load_gripper(name).hash
    if hashes[name] != attempt.gripper_hash:
        raise DataError(
            f"it was made with another description of {name} ({attempt.gripper_hash}, now "
            f"{hashes[name]}); expected the same gripper."
        )

"""Scenes of the size of real ones, and device packs of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from dataset_records import labels, record

from megrasp_core.storage import DevicePack, PackSource, SceneRecord, write_pack

GRIPPERS = ("robotiq_2f85", "franka_hand", "robotiq_3f", "google_gripper")
MANIFEST = {"config": "test", "grippers": {name: f"hash of {name}" for name in GRIPPERS}}


def heap(seed: int, *, grasps: int = 50) -> SceneRecord:
    """A scene of the size of real ones: a table with spheres, seen by a grid of 4 mm."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(-0.24, 0.24, 0.004)]))
    points = np.stack([x, y, np.zeros_like(x)], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    for centre in rng.uniform(-0.2, 0.2, (8, 2)):
        low, radius = points[:, :2] - centre, rng.uniform(0.02, 0.06)
        up = np.sqrt(np.maximum(radius**2 - (low**2).sum(axis=1), 0.0))
        higher = up > points[:, 2]
        points[higher, 2] = up[higher]
        normals[higher] = np.hstack([low[higher], up[higher, None]]) / radius
    on_plane = points[:, 2] == 0.0
    points += rng.normal(scale=0.0007, size=points.shape)
    return dataclasses.replace(
        record(seed, in_bin=seed % 2 == 0),
        points=points.astype(np.float16),
        normals=np.rint(normals * 127).astype(np.int8),
        on_plane=on_plane,
        labels={name: labels(rng, grasps, 3) for name in GRIPPERS},
    )


def packed(path: Path, records: list[SceneRecord]) -> DevicePack:
    """The pack of one data set."""
    source = PackSource("set", MANIFEST, records, len(records))
    assert write_pack(path, [source]) == path.stat().st_size
    return DevicePack(path)


def made_records() -> list[SceneRecord]:
    """Four scenes; the third and fourth do not begin at a whole byte of flags."""
    small = dataclasses.replace(record(13), labels={})
    return [heap(10), small, heap(11), dataclasses.replace(heap(12), labels={})]

"""Small valid records for the storage tests."""

from __future__ import annotations

import numpy as np

from megrasp_core.simulation import Bin
from megrasp_core.storage import NOT_TRIED, ROBUST_TRIALS, GripperLabels, Kind, SceneRecord


def labels(rng: np.random.Generator, count: int, objects: int) -> GripperLabels:
    """Random valid labels."""
    pose = rng.normal(size=(count, 7)).astype(np.float32)
    pose[:, :3] *= 0.1
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    label = rng.integers(0, 2, count).astype(np.int8)
    kind = np.where(label == 1, Kind.JUDGED, Kind.COLLISION).astype(np.int8)
    reason = np.where(label == 1, "", "start_collision")
    owner = rng.integers(0, objects, count).astype(np.int16)
    extra = np.where(label == 1, rng.integers(0, objects, count), NOT_TRIED).astype(np.int8)
    robust = np.where(label == 1, rng.integers(NOT_TRIED, ROBUST_TRIALS + 1, count), NOT_TRIED)
    return GripperLabels(
        world_from_tcp=pose,
        object=owner,
        label=label,
        kind=kind,
        reason=reason,
        extra=extra,
        robust=robust.astype(np.int8),
    )


def record(seed: int, *, in_bin: bool = True) -> SceneRecord:
    """A random valid record."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = np.zeros((3, 7), np.float32)
    poses[:, :3] = rng.normal(scale=0.1, size=(3, 3))
    poses[:, 6] = 1.0
    return SceneRecord(
        name=f"scene_{seed:010d}",
        seed=seed,
        object_names=("procedural/000001", "procedural/000002", "obstacle/000003"),
        object_poses=poses,
        obstacle=np.array([False, False, True]),
        bin=Bin((0.4, 0.3, 0.15), 0.005, (0.03, -0.06), (0.1, 0.5, 0.9)) if in_bin else None,
        points=rng.normal(scale=0.1, size=(50, 3)).astype(np.float16),
        normals=np.rint(normals * 127).astype(np.int8),
        on_plane=rng.random(50) < 0.3,
        sensor=np.array([0.01, 0.02, 0.85], np.float32),
        gravity=np.array([0, 0, -1], np.float32),
        labels={
            "first": labels(rng, 7, 3),
            "second": labels(rng, 0, 3),
            "third": labels(rng, 4, 3),
        },
    )


def assert_equal(first: SceneRecord, second: SceneRecord) -> None:
    """All fields equal bit for bit."""
    for name in ("name", "seed", "object_names", "bin"):
        assert getattr(first, name) == getattr(second, name)
    for name in (
        "object_poses",
        "obstacle",
        "points",
        "normals",
        "on_plane",
        "sensor",
        "gravity",
    ):
        a, b = getattr(first, name), getattr(second, name)
        assert a.dtype == b.dtype and a.shape == b.shape
        assert a.tobytes() == b.tobytes(), name
    assert sorted(first.labels) == sorted(second.labels)
    for gripper, a in first.labels.items():
        b = second.labels[gripper]
        for name in ("world_from_tcp", "object", "label", "kind", "reason", "extra", "robust"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))

"""A small scene and gripper for the network's tests, and rigid motions of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import GripperTokens
from megrasp_core.network.irreps import pack, unpack
from megrasp_core.pointcloud import SceneNodes, SurfacePoints


def scene(count: int = 300, seed: int = 0) -> SceneNodes:
    """Random nodes with unit normals and gravity."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.15, 0.15, (count, 3)).astype(np.float32)
    points -= points.mean(0)
    normals = rng.normal(size=(count, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    gravity = np.array([0.0, 0.0, -1.0], np.float32)
    on_plane = rng.random(count) < 0.3
    fine = rng.uniform(-0.15, 0.15, (4 * count, 3)).astype(np.float32)
    surface = SurfacePoints(fine, np.tile(normals[::-1], (4, 1)), rng.random(4 * count) < 0.3)
    return SceneNodes(points, normals, on_plane, gravity, np.zeros(3), surface)


def on_flat(layer: torch.nn.Module) -> Callable[[torch.Tensor], torch.Tensor]:
    """A layer from flat features to flat features, e3nn's layout."""
    return lambda x: pack(layer(unpack(x, layer.irreps_in)))


def tokens(count: int, seed: int = 1) -> GripperTokens:
    """Random gripper tokens, `count` per posture."""
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=0.04, size=(2 * count, 3))
    normals = rng.normal(size=(2 * count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return GripperTokens(points, normals, np.arange(2 * count) >= count, 0.3 * points)


def moved(nodes: SceneNodes, rotation: np.ndarray, shift: np.ndarray) -> SceneNodes:
    """The scene turned about its centroid and moved; float64, so that the motion itself is
    exact.
    """
    turn = rotation.T
    surface = nodes.surface
    return dataclasses.replace(
        nodes,
        points=nodes.points.astype(np.float64) @ turn + shift,
        normals=nodes.normals.astype(np.float64) @ turn,
        gravity=nodes.gravity.astype(np.float64) @ turn,
        surface=surface
        and dataclasses.replace(
            surface,
            points=surface.points.astype(np.float64) @ turn + shift,
            normals=surface.normals.astype(np.float64) @ turn,
        ),
    )


def motions(count: int, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Random rotations (3, 3) and shifts (3,) m."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=seed).as_matrix()
    return [(turn, rng.uniform(-0.2, 0.2, 3)) for turn in turns]

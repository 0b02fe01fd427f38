"""A small depth camera for the point cloud tests: rays cast into boxes that stand on a table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

CAMERA = np.array([0.05, -0.03, 0.85])


@dataclass(frozen=True)
class Picture:
    """points, normals (N, 3) in the world; owner (N,): 0 the table, else 1 + the box."""

    points: np.ndarray
    owner: np.ndarray
    normals: np.ndarray
    sensor: np.ndarray


def cast(boxes: list[tuple[np.ndarray, np.ndarray]], table: float = 0.3) -> Picture:
    """Render boxes (world_from_box, size) on the table z = 0, half width `table`, from CAMERA."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    floor = o3d.geometry.TriangleMesh.create_box(2 * table, 2 * table, 0.01)
    floor.translate([-table, -table, -0.01])
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(floor))
    for pose, size in boxes:
        mesh = o3d.geometry.TriangleMesh.create_box(*size)
        mesh.translate(-np.asarray(size) / 2)
        mesh.transform(pose)
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    u, v = np.meshgrid(np.arange(240) - 119.5, np.arange(240) - 119.5)
    rays = np.stack([u / 260, v / 260, -np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ray6 = np.concatenate([np.broadcast_to(CAMERA, rays.shape), rays], axis=1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(ray6))
    depth = hit["t_hit"].numpy().astype(np.float64)
    seen = np.isfinite(depth)
    normals = hit["primitive_normals"].numpy()[seen].astype(np.float64)
    normals[(normals * rays[seen]).sum(axis=1) > 0] *= -1
    return Picture(
        CAMERA + rays[seen] * depth[seen, None],
        hit["geometry_ids"].numpy()[seen].astype(int),
        normals,
        CAMERA.copy(),
    )


def standing(x: float, y: float, size: tuple[float, float, float], yaw: float = 0.0):
    """Return (world_from_box, size) of a box that stands on the table."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    pose[:3, 3] = [x, y, size[2] / 2]
    return pose, np.array(size)


@pytest.fixture(scope="session")
def render() -> Callable[..., Picture]:
    """The renderer."""
    return cast


@pytest.fixture(scope="session")
def heap() -> Picture:
    """Four boxes on a table."""
    return cast(
        [
            standing(0.0, 0.0, (0.06, 0.05, 0.08), 0.4),
            standing(0.12, 0.05, (0.05, 0.09, 0.04), -0.3),
            standing(-0.11, 0.07, (0.04, 0.04, 0.12), 0.9),
            standing(-0.04, -0.12, (0.10, 0.03, 0.03), 0.1),
        ]
    )


@pytest.fixture(scope="session")
def motion() -> np.ndarray:
    """A rigid motion (4, 4) far from any symmetry of the grid."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    matrix[:3, 3] = [0.31, -0.22, 0.57]
    return matrix

"""Meshes of very many triangles."""

from __future__ import annotations

import numpy as np
import trimesh

from megrasp_core.grippers import BodyMesh, make_clouds
from megrasp_core.meshes import Mesh, thinned
from megrasp_core.meshes.thinning import MOST


def box() -> Mesh:
    """A box of 12 triangles."""
    mesh = trimesh.creation.box((0.10, 0.06, 0.04))
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64))


def bumpy_torus(around: int, across: int) -> Mesh:
    """A ring with a radius of 80 mm, 30 mm thick with bumps of 2 mm."""
    u = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[:, None]
    v = np.linspace(0.0, 2.0 * np.pi, across, endpoint=False)[None]
    thick = 0.03 + 0.002 * np.sin(12.0 * u) * np.sin(9.0 * v)
    far = 0.08 + thick * np.cos(v)
    points = np.stack([far * np.cos(u), far * np.sin(u), thick * np.sin(v)], axis=-1)
    index = np.arange(around * across).reshape(around, across)
    right, up = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    quads = np.stack([index, right, both, up], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(points.reshape(-1, 3), faces)


def test_a_million_triangles() -> None:
    """Thinned to a tenth, the surface stays within half a millimetre and smooth."""
    mesh = bumpy_torus(1000, 500)
    assert len(mesh.faces) == 10**6
    pose = np.eye(4)[None].copy()
    pose[0, :3, 3] = 0.1
    clouds = make_clouds([BodyMesh(0, mesh)], np.eye(4)[None], pose, count=1024, seed=0)
    np.testing.assert_allclose(clouds.displacement, 0.1, atol=1e-12)
    for shift, points, normals in (
        (0.0, clouds.open_points, clouds.open_normals),
        (0.1, clouds.closed_points, clouds.closed_normals),
    ):
        x, y, z = (points - shift).T
        u, v = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - 0.08)
        thick = 0.03 + 0.002 * np.sin(12.0 * u) * np.sin(9.0 * v)
        off = np.hypot(np.hypot(x, y) - 0.08, z) - thick
        assert np.abs(off).max() < 5e-4
        assert np.abs(off).mean() < 5e-5
        radial = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
        assert (radial * normals).sum(axis=1).min() > 0.5


def test_thinning() -> None:
    """Light meshes stay as they are; heavy ones lose triangles but stay closed, and large
    triangles among them stay where they are.
    """
    light = [box()]
    assert thinned(light) is light
    heavy = [bumpy_torus(600, 300), box()]
    (vertices, faces), (corners, sides) = thinned(heavy)
    assert len(heavy[0][1]) > MOST > 100_000 > len(faces) > 30_000
    np.testing.assert_allclose(corners[sides], heavy[1][0][heavy[1][1]], atol=1e-12)
    large = [Mesh(3.0 * heavy[0].vertices, heavy[0].faces)]
    assert len(thinned(large)[0][1]) > 200_000, "cells do not grow beyond 2 mm"
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth = edges[:, 0] * len(vertices) + edges[:, 1]
    back = edges[:, 1] * len(vertices) + edges[:, 0]
    np.testing.assert_array_equal(np.sort(forth), np.sort(back))

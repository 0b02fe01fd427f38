"""Triangle meshes, rays against them, points on them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from megrasp_core.meshes import (
    Mesh,
    RayScene,
    SurfaceScene,
    joined,
    sample_stratified,
    sample_uniform,
)


def box(*extents: float) -> Mesh:
    mesh = trimesh.creation.box(extents)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64))


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def test_area_and_joining() -> None:
    small, large = box(1.0, 1.0, 1.0), box(2.0, 2.0, 2.0).moved(at(5.0))
    both = joined([small, large])
    assert small.area == pytest.approx(6.0)
    assert both.area == pytest.approx(6.0 + 24.0)
    assert both.vertices[both.faces[12:]].min(axis=(0, 1)).tolist() == [4.0, -1.0, -1.0]
    assert joined([]).faces.shape == (0, 3)


def test_rays_tell_what_they_hit_first() -> None:
    boxes = [box(1.0, 1.0, 1.0), box(1.0, 1.0, 1.0).moved(at(3.0))]
    scene = RayScene(boxes, apart=True)
    rays = np.array([[-2.0, 0, 0, 1, 0, 0], [1.5, 0, 0, 1, 0, 0], [-2.0, 0, 0, -1, 0, 0]])
    hits = scene.cast(rays)
    np.testing.assert_allclose(hits.distance, [1.5, 1.0, np.inf], rtol=1e-6)
    assert hits.mesh[:2].tolist() == [0, 1]
    assert hits.normals[0].tolist() == [-1.0, 0.0, 0.0]
    assert hits.normals[2].tolist() == [0.0, 0.0, 0.0]
    assert scene.blocked(rays).tolist() == [True, True, False]
    image = scene.cast(np.tile(rays, (4, 1, 1)))
    assert image.distance.shape == image.mesh.shape == (4, 3)
    assert image.normals.shape == (4, 3, 3)
    assert (image.distance == hits.distance).all()
    assert scene.cast(np.zeros((0, 6))).distance.shape == (0,)
    assert RayScene([]).cast(rays).distance.tolist() == [np.inf] * 3
    ray, distance, _ = SurfaceScene(boxes).crossings(rays[:1])
    assert ray.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(np.sort(distance), [1.5, 2.5, 4.5, 5.5], rtol=1e-6)


def test_the_nearest_point_and_its_distance() -> None:
    scene = SurfaceScene([box(1.0, 1.0, 1.0)])
    points = np.array([[2.0, 0.1, 0.2], [0.0, 0.0, 0.1]])
    np.testing.assert_allclose(scene.distance(points), [1.5, 0.4], atol=1e-6)
    np.testing.assert_allclose(
        scene.nearest(points), [[0.5, 0.1, 0.2], [0.0, 0.0, 0.5]], atol=1e-6
    )


def test_first_hits_are_the_nearest_crossings() -> None:
    """Two engines agree on a surface that is not convex."""
    knot = trimesh.creation.torus(0.3, 0.1)
    meshes = [Mesh(np.array(knot.vertices), np.array(knot.faces, np.int64))]
    rng = np.random.default_rng(4)
    rays = np.hstack([rng.normal(size=(500, 3)), 0.3 * rng.normal(size=(500, 3))])
    rays[:, 3:] -= rays[:, :3]
    ray, distance, _ = SurfaceScene(meshes).crossings(rays)
    first = np.full(500, np.inf)
    np.minimum.at(first, ray, distance)
    hits = RayScene(meshes).cast(rays)
    assert 50 < np.isfinite(first).sum() < 450
    np.testing.assert_allclose(hits.distance, first, rtol=1e-5)
    assert (RayScene(meshes).blocked(rays) == np.isfinite(first)).all()


def test_points_are_drawn_by_area() -> None:
    """A face of a slab gets its share: within 5 standard deviations, or exactly to one point where
    the draw is stratified.
    """
    slab = box(1.0, 1.0, 0.1)
    share = 1.0 / slab.area
    points, triangle = sample_uniform(slab, 20_000, np.random.default_rng(0))
    top = points[:, 2] > 0.0499999
    assert abs(top.mean() - share) < 5.0 * np.sqrt(share * (1.0 - share) / 20_000)
    corner = slab.vertices[slab.faces[triangle]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    off = ((points - corner[:, 0]) * normal).sum(axis=1)
    assert np.abs(off).max() < 1e-12
    for half in (top, np.abs(points[:, 0]) < 0.25):
        assert half.any() and not half.all()
    sample = sample_stratified([slab, box(1.0, 1.0, 1.0).moved(at(3.0))], 1000, seed=1)
    expected = 1000 * slab.area / (slab.area + 6.0)
    assert abs((sample.mesh == 0).sum() - expected) <= 1.0
    assert (sample.normals[sample.mesh == 0] @ [0, 0, 1.0] > 0.99).sum() == pytest.approx(
        1000 / (slab.area + 6.0), abs=2.5
    )


def test_a_mesh_without_area_is_told() -> None:
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="expected finite vertices and at least one mesh"):
        sample_stratified([flat], 10, seed=0)

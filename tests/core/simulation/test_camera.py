"""Depth images, noise and clouds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from jaw_and_boxes import Jaw, at, make_box

from megrasp_core.simulation import (
    Bin,
    Camera,
    DepthNoise,
    TopDownCamera,
    View,
    World,
    build_world,
    depth_to_points,
    look_at,
    observe,
    render_depth,
    render_view,
    ring_cameras,
)


@pytest.fixture
def world(jaw: Jaw) -> World:
    poses = np.stack([at(0.05, -0.03, 0.03), at(-0.1, 0.05, 0.025), at(0, 0, 0.2)])
    world = build_world(
        [make_box((0.08, 0.06, 0.06)), make_box((0.05, 0.05, 0.05)), make_box((0.2, 0.2, 0.01))],
        gripper=jaw,
        bin=Bin(),
        object_poses=poses,
        visual=True,
    )
    world.park_object(2)
    world.place_gripper(at(0, 0, 0.3))
    world.forward()
    return world


def test_depth_of_known_surfaces(world: World) -> None:
    camera = TopDownCamera(0.85)
    view = render_view(world, camera)
    pixel = camera.intrinsics() @ np.array([0.05, 0.03, 0.79])  # image y runs along world -y
    u, v = np.round(pixel[:2] / pixel[2]).astype(int)
    assert view.owner[v, u] == 0
    assert view.depth[v, u] == pytest.approx(0.85 - 0.06, abs=1e-3)
    # Neither the gripper, 55 cm below the lens, nor the parked plate is in the middle.
    assert view.depth[camera.height // 2, camera.width // 2] == pytest.approx(0.85, abs=1e-3)
    assert set(np.unique(view.owner)) == {-1, 0, 1}


def test_points_lie_on_the_scene_and_the_image_axes_are_right(world: World) -> None:
    camera = TopDownCamera(0.85)
    depth = render_depth(world, camera)
    points = depth_to_points(depth, camera).reshape(camera.height, camera.width, 3)
    assert (np.diff(points[..., 0], axis=1)[240] > -1e-6).all()  # x along world x
    assert points[0, 320, 1] > points[-1, 320, 1]  # image down is world -y
    on_box = (np.abs(points[..., 0] - 0.05) < 0.039) & (np.abs(points[..., 1] + 0.03) < 0.029)
    assert on_box.sum() > 1000
    assert points[on_box][:, 2] == pytest.approx(0.06, abs=1e-3)
    assert points[0, 0] == pytest.approx([-0.289, 0.217, 0.0], abs=2e-3)


@pytest.mark.parametrize("camera", [TopDownCamera(width_px=96, height_px=72), *ring_cameras(2)])
def test_agrees_with_mujocos_own_rays(world: World, camera: Camera) -> None:
    rays = camera.rays() @ camera.world_from_camera[:3, :3].T
    vectors = np.ascontiguousarray(rays.reshape(-1, 3))
    count = len(vectors)
    geoms, distance = np.empty(count, dtype=np.int32), np.empty(count)
    groups = np.array([0, 1, 1, 0, 0, 0], dtype=np.uint8)
    common = (
        world.model,
        world.data,
        camera.position,
        vectors.ravel(),
        groups,
        True,
        -1,
        geoms,
        distance,
    )
    try:
        mujoco.mj_multiRay(*common, None, count, 10.0)
    except TypeError:  # before MuJoCo 3.4 no normals were returned
        mujoco.mj_multiRay(*common, count, 10.0)
    expected = np.where((distance < 0) | (distance > camera.far), 0.0, distance)
    depth = render_depth(world, camera).ravel()
    same = np.abs(depth - expected) < 1e-4
    assert same.mean() > 0.998  # rays along an edge may fall on either side


def test_cloud_knows_where_it_was_seen_from(world: World) -> None:
    camera = TopDownCamera()
    cloud = observe(world, camera)
    assert cloud.viewpoint == pytest.approx([0, 0, 0.85])
    assert len(cloud.points) == camera.width * camera.height
    assert cloud.points[:, 2].max() == pytest.approx(0.15, abs=1e-3)  # rim of the bin, no gripper
    cameras = ring_cameras(3)
    dense = observe(world, cameras)
    assert dense.viewpoint is not None and dense.viewpoint.shape == dense.points.shape
    assert np.unique(dense.viewpoint, axis=0) == pytest.approx(
        np.unique([c.position for c in cameras], axis=0)
    )
    below = dense.points[:, 2] < 0.149
    lit = np.abs(dense.points[below] - [0.05, -0.03, 0.03]).max(axis=1) < 0.05
    assert lit.sum() > 500 and dense.points[:, 2].min() > -1e-3


def test_cameras_look_where_they_should() -> None:
    for camera in ring_cameras(10):
        pose = camera.world_from_camera
        assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3))
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        toward = np.array([0, 0, 0.03]) - camera.position
        assert pose[:3, 2] == pytest.approx(toward / np.linalg.norm(toward))
        assert pose[2, 1] < 0  # the picture is upright
    top = look_at(np.array([0, 0, 1.0]), np.zeros(3))
    assert top[:3, 0] == pytest.approx([1, 0, 0]) and top[:3, 1] == pytest.approx([0, -1, 0])


def flat(depth: float, incidence: float = 1.0) -> View:
    shape = (120, 160)
    return View(
        np.full(shape, depth, np.float32),
        np.full(shape, -1, np.int32),
        np.full(shape, incidence, np.float32),
    )


def test_noise_grows_with_the_square_of_distance_and_with_slant() -> None:
    noise = DepthNoise(axial_base=0.0, step_square=0.0)

    def spread(view: View) -> float:
        noisy = noise.apply(view, np.random.default_rng(0))
        return float(np.std(noisy[noisy > 0]))

    near, far, slanted = spread(flat(0.5)), spread(flat(1.0)), spread(flat(1.0, 0.5))
    assert near == pytest.approx(0.0014 * 0.25, rel=0.1)
    assert far / near == pytest.approx(4.0, rel=0.1)
    assert slanted / far == pytest.approx(2.0, rel=0.1)


def test_noise_is_repeatable_and_loses_edges_steep_and_shiny_pixels(world: World) -> None:
    view = render_view(world, TopDownCamera())
    noise = DepthNoise()
    noisy = noise.apply(view, np.random.default_rng(3))
    assert np.array_equal(noisy, noise.apply(view, np.random.default_rng(3)))
    table = (view.owner == -1) & (view.incidence > 0.9) & (view.depth > 0.84)
    assert (noisy[table] == 0).mean() < 0.02
    assert (noisy[view.incidence < 0.1] == 0).all()
    box = view.owner == 0
    edge = box & ~np.roll(box, 1, axis=1)
    assert (noisy[edge] == 0).mean() > 0.25
    shiny = DepthNoise(shiny_share=1.0).apply(view, np.random.default_rng(3))
    assert (shiny[box & (view.incidence > 0.98)] == 0).all()
    steps = np.unique(
        DepthNoise(axial_base=0, axial_square=0).apply(flat(0.8), np.random.default_rng(0))
    )
    assert len(steps) == 1

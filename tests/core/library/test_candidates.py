"""Antipodal candidates: geometry of pairs and poses, on shapes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.library import CandidateSettings, ObjectSurface, antipodal
from megrasp_core.library.candidates import opposing_pairs, width_range
from megrasp_core.objects import ObjectModel, procedural_object


def model_of(mesh: trimesh.Trimesh) -> ObjectModel:
    return ObjectModel(
        "shape",
        np.asarray(mesh.vertices),
        np.asarray(mesh.faces),
        ((np.asarray(mesh.vertices), np.asarray(mesh.faces)),),
        0.1,
        np.eye(3) * 1e-4,
    )


@pytest.fixture(scope="module")
def gripper() -> Gripper:
    return load_gripper("robotiq_2f85")


@pytest.fixture(scope="module")
def box() -> ObjectModel:
    return model_of(trimesh.creation.box((0.04, 0.20, 0.20)))


def test_pairs_of_a_slab_cross_it_where_it_is_thin(box):
    rng = np.random.default_rng(0)
    pairs = opposing_pairs(ObjectSurface(box), 2000, (0.002, 0.08), CandidateSettings(), rng)
    assert len(pairs.first) > 500
    across = pairs.second - pairs.first
    np.testing.assert_allclose(np.abs(across[:, 0]), 0.04, atol=1e-5)
    np.testing.assert_allclose(np.abs(pairs.first[:, 0]), 0.02, atol=1e-5)
    angle = np.arccos(np.abs(across[:, 0]) / np.linalg.norm(across, axis=1))
    assert angle.max() <= CandidateSettings().friction_cone + 1e-6
    # The noise turns the axis away from the normal: not all are straight through.
    assert angle.mean() > np.deg2rad(3)


def test_pairs_can_take_one_wall_or_both_of_a_hollow_shape():
    tube = model_of(trimesh.creation.annulus(r_min=0.027, r_max=0.03, height=0.1))
    rng = np.random.default_rng(1)
    pairs = opposing_pairs(ObjectSurface(tube), 4000, (0.002, 0.08), CandidateSettings(), rng)
    width = np.linalg.norm(pairs.second - pairs.first, axis=1)
    wall, through = width < 0.005, np.abs(width - 0.06) < 0.006
    assert wall.mean() > 0.2 and through.mean() > 0.1


def test_candidates_put_the_tcp_between_the_points_with_closing_axis_along_them(box, gripper):
    settings = CandidateSettings()
    found = antipodal(box, gripper, 300, np.random.default_rng(2))
    assert len(found) == 300
    pose = found.object_from_gripper @ gripper.gripper_from_tcp
    rotation = pose[:, :3, :3]
    np.testing.assert_allclose(
        rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (300, 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-9)
    # +X crosses the slab, between whose sides the TCP is off the middle by depth and shift only.
    assert (np.abs(rotation[:, 0, 0]) >= np.cos(settings.friction_cone) - 1e-6).all()
    reach = max(map(abs, settings.depth)) + settings.shift
    assert (np.abs(pose[:, 0, 3]) <= reach).all()
    low, high = width_range(gripper, settings)
    assert (found.width >= low).all() and (found.width <= high).all()
    # Both senses of the closing axis, and approaches from all around it.
    assert 0.3 < (rotation[:, 0, 0] > 0).mean() < 0.7
    azimuth = np.arctan2(rotation[:, 2, 2], rotation[:, 1, 2])
    assert np.histogram(azimuth, bins=6, range=(-np.pi, np.pi))[0].min() > 20


def test_depth_is_along_the_approach_within_its_range(box, gripper):
    deep = CandidateSettings(depth=(0.02, 0.02), shift=0.0, axis_noise=0.0)
    flat = CandidateSettings(depth=(0.0, 0.0), shift=0.0, axis_noise=0.0)
    poses = [
        antipodal(box, gripper, 50, np.random.default_rng(3), settings=s).object_from_gripper
        for s in (deep, flat)
    ]
    move = poses[0][:, :3, 3] - poses[1][:, :3, 3]
    np.testing.assert_allclose(move, 0.02 * poses[0][:, :3, 2], atol=1e-9)
    np.testing.assert_allclose(poses[0][:, :3, :3], poses[1][:, :3, :3], atol=1e-12)


def test_too_wide_objects_give_no_candidate(gripper):
    wide = model_of(trimesh.creation.box((0.12, 0.12, 0.12)))
    assert len(antipodal(wide, gripper, 50, np.random.default_rng(0))) == 0
    assert len(antipodal(wide, load_gripper("robotiq_3f"), 50, np.random.default_rng(0))) == 50


def test_approaches_can_be_kept_near_a_direction(gripper):
    limit, down = np.deg2rad(35.0), np.array([0.0, 0.6, -0.8])
    for seed in range(3):
        model = procedural_object(seed)
        found = antipodal(
            model, gripper, 100, np.random.default_rng(seed), approach_towards=(down, limit)
        )
        assert len(found) > 20
        approach = found.object_from_gripper[:, :3, 2]
        assert (approach @ down >= np.cos(limit) - 1e-9).all()


def test_the_same_generator_state_gives_the_same_candidates(box, gripper):
    first, second, third = (
        antipodal(box, gripper, 40, np.random.default_rng(seed)).object_from_gripper
        for seed in (5, 5, 6)
    )
    assert first.tobytes() == second.tobytes()
    assert first.tobytes() != third.tobytes()


def test_points_are_even_over_the_surface(box):
    points, normals = ObjectSurface(box).sample(20000, np.random.default_rng(0))
    on_side = np.abs(np.abs(points[:, 0]) - 0.02) < 1e-9
    expected = 2 * 0.2 * 0.2 / (2 * 0.2 * 0.2 + 4 * 0.2 * 0.04)
    assert on_side.mean() == pytest.approx(expected, abs=0.015)
    assert (np.abs(normals[on_side, 0]) > 0.999).all()

"""A bin that is propped up on one side, and how bins of training scenes are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaw_and_boxes import make_box

from megrasp_core.objects import ObjectSet, procedural_names
from megrasp_core.scenes import SceneConfig, draw_layout
from megrasp_core.scenes.observing import scene_surface
from megrasp_core.simulation import Bin, SettledScene, TopDownCamera, build_world, observe, settle
from megrasp_core.simulation.clutter import rest_check

TILTED = Bin((0.40, 0.30, 0.15), wall=0.01, tilt=(0.06, -0.08), colour=(0.9, 0.1, 0.2))
BOXES = [make_box((0.03, 0.04, 0.05)), make_box((0.06, 0.05, 0.03)), make_box((0.05, 0.05, 0.05))]


@pytest.fixture(scope="module")
def settled() -> SettledScene:
    return settle(BOXES, bin=TILTED, rng=np.random.default_rng(0))


def test_it_stands_on_the_table_with_its_lowest_edge():
    pose = TILTED.world_from_bin
    corners = []
    for centre, half in [*TILTED.wall_boxes(), *TILTED.floor_boxes()]:
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners.append((centre + signs * half) @ pose[:3, :3].T + pose[:3, 3])
    assert np.concatenate(corners)[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert np.arccos(pose[2, 2]) == pytest.approx(np.hypot(*TILTED.tilt))
    upright = Bin(TILTED.inner)
    np.testing.assert_array_equal(upright.world_from_bin, np.eye(4))
    assert upright.floor_boxes() == []


def test_what_settles_in_it_lies_inside_and_stays_where_it_is(settled):
    assert settled.ok and settled.bin == TILTED and len(settled.kept) == 3
    inside = np.linalg.inv(TILTED.world_from_bin) @ settled.object_poses
    assert (np.abs(inside[:, :2, 3]) < np.array(TILTED.inner[:2]) / 2).all()
    assert (inside[:, 2, 3] > 0.01).all()
    # The scene was settled with gravity tilted; here the bin is.
    world = settled.world()
    shift, angle = rest_check(world, 1.0)
    assert shift < 0.002 and angle < np.deg2rad(4)


def test_the_camera_sees_its_floor_and_colour(settled):
    cloud = observe(settled.world(), TopDownCamera())
    inside = TILTED.region().contains(cloud.points) & (cloud.points[:, 2] > 0)
    in_bin = (cloud.points - TILTED.world_from_bin[:3, 3]) @ TILTED.world_from_bin[:3, :3]
    floor = inside & (np.abs(in_bin[:, 2]) < 1e-4)
    assert floor.sum() > 0.3 * inside.sum()
    assert cloud.colors is not None
    np.testing.assert_allclose(np.median(cloud.colors[floor], axis=0), TILTED.colour)


def test_drawn_bins_differ_and_their_floors_are_found():
    objects = ObjectSet(procedural_names(4))
    config = SceneConfig((), objects=(2, 2), bin_share=1.0, bin_tilted=1.0, obstacle_share=0.0)
    bins = []
    for seed in range(3):
        layout = draw_layout(seed, config, objects)
        assert layout.bin is not None
        bins.append(layout.bin)
        surface = scene_surface(layout, seed, config, objects)
        assert surface.on_plane.mean() > 0.2
        pose = layout.bin.world_from_bin
        height = (surface.points[surface.on_plane] - pose[:3, 3]) @ pose[:3, 2]
        assert np.abs(np.median(height)) < 0.003
    assert len({bin.wall for bin in bins}) == len({bin.tilt for bin in bins}) == 3
    assert len({bin.colour for bin in bins}) == 3
    assert all(0.003 <= bin.wall <= 0.015 for bin in bins)
    assert all(0 < np.hypot(*bin.tilt) <= np.deg2rad(6.001) for bin in bins)
    upright = draw_layout(0, replace(config, bin_tilted=0.0), objects).bin
    assert upright is not None and not any(upright.tilt)


def test_an_object_slides_down_a_steep_slippery_floor():
    steep = Bin((0.40, 0.30, 0.15), tilt=(0.0, 0.35))
    pose = steep.world_from_bin.copy()
    pose[:3, 3] += steep.world_from_bin[:3, 2] * 0.0255
    world = build_world(
        [make_box((0.05, 0.05, 0.05))], bin=steep, friction=0.05, object_poses=pose[None]
    )
    rest_check(world, 0.6)
    moved = steep.world_from_bin[:3, :3].T @ (world.object_poses()[0, :3, 3] - pose[:3, 3])
    assert moved[0] > 0.1 and abs(moved[2]) < 0.005

"""Free, occupied, unseen, wall, floor."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.errors import CloudError, InvalidRequestError
from megrasp_core.pointcloud import OrientedBox, Plane, View
from megrasp_core.ranking import PointState, SceneObservation
from megrasp_core.ranking.cover import SurfaceCover

TALL = ((-0.05, -0.03, 0.0), (0.0, 0.03, 0.08))
HIDDEN = ((0.0, -0.02, 0.0), (0.012, 0.02, 0.03))
"""Stands in the shadow that a camera at (-0.45, 0, 0.85) leaves behind TALL."""
DOWN = np.array([0.0, 0.0, -1.0])
BIN = OrientedBox.around((0.0, 0.0, 0.075), (0.40, 0.30, 0.15))


def states(observation: SceneObservation, *points: tuple[float, float, float]) -> list[PointState]:
    """States of single points."""
    return [PointState(s) for s in observation.classify(np.array(points))]


def test_space_in_front_is_free_and_the_seen_body_is_inside(seen, camera):
    observation = SceneObservation(seen([TALL]), camera, gravity=DOWN)
    assert states(observation, (-0.025, 0, 0.10)) == [PointState.FREE]
    assert states(observation, (-0.025, 0, 0.079)) == [PointState.NEAR]
    assert states(observation, (-0.025, 0, 0.072)) == [PointState.INSIDE]
    assert states(observation, (-0.005, 0, 0.02)) == [PointState.UNSEEN]


def test_what_lies_under_a_seen_top_away_from_its_outline_is_the_body(seen, camera):
    deep, by_the_side = (-0.025, 0.0, 0.02), (-0.005, 0.0, 0.02)
    known = SceneObservation(seen([TALL]), camera, gravity=DOWN)
    assert states(known, deep, by_the_side) == [PointState.INSIDE, PointState.UNSEEN]
    # Nobody knows what is below the top without knowing where below is.
    assert states(SceneObservation(seen([TALL]), camera), deep) == [PointState.UNSEEN]
    # Something narrow has no such inner part: its handle may be a bridge.
    bridge = ((-0.05, -0.006, 0.05), (0.05, 0.006, 0.06))
    bridge = SceneObservation(seen([bridge]), camera, gravity=DOWN)
    assert states(bridge, (0.0, 0.0, 0.02)) == [PointState.UNSEEN]


def test_stray_points_over_the_scene_cover_nothing(seen, camera):
    strays = np.random.default_rng(0).uniform((-0.2, -0.15, 0.1), (0.2, 0.15, 0.2), (60, 3))
    points = np.concatenate([seen([TALL]), strays])
    observation = SceneObservation(points, camera, gravity=DOWN)
    grid = np.stack(np.meshgrid(np.linspace(0.02, 0.18, 50), np.linspace(-0.1, 0.1, 50)), axis=-1)
    over_the_floor = np.concatenate([grid.reshape(-1, 2), np.full((2500, 1), 0.03)], axis=1)
    assert (observation.classify(over_the_floor) == PointState.INSIDE).mean() < 0.01


def test_one_point_a_kilometre_away_and_a_hall_cost_no_memory(seen, camera):
    deep = np.array([[-0.025, 0.0, 0.02]])
    stray = np.array([[1000.0, -800.0, 0.0]])
    cover = SurfaceCover(np.concatenate([seen([TALL]), stray]), DOWN, 0.008, 0.001)
    assert cover.depth(deep)[0] == pytest.approx(0.06, abs=1e-3)
    hall = np.random.default_rng(0).uniform((-50, -50, 0), (50, 50, 0.1), (10000, 3))
    assert SurfaceCover(hall, DOWN, 0.008, 0.001).depth(deep)[0] == -np.inf


def test_depth_behind_the_surface_is_the_distance_along_the_view(seen, camera):
    observation = SceneObservation(seen([TALL]), camera, gravity=DOWN)
    heights = np.array([0.12, 0.09, 0.075, 0.05])
    points = np.stack([np.full(4, -0.025), np.zeros(4), heights], axis=1)
    np.testing.assert_allclose(observation.signed_depth(points), 0.08 - heights, atol=5e-4)


def test_the_space_of_an_occluded_neighbour_is_unseen_not_free(seen):
    side = np.array([-0.45, 0.0, 0.85])
    with_neighbour = SceneObservation(seen([TALL, HIDDEN], side), side, gravity=DOWN)
    without = SceneObservation(seen([TALL], side), side, gravity=DOWN)
    inside_the_neighbour = (0.006, 0.0, 0.015)
    for observation in (with_neighbour, without):
        assert states(observation, inside_the_neighbour) == [PointState.UNSEEN]
    np.testing.assert_array_equal(
        with_neighbour.images[0].seen, without.images[0].seen, "the neighbour is not wholly hidden"
    )
    assert states(without, (0.10, 0.0, 0.015)) == [PointState.FREE]


SHINY = ((0.03, -0.05, 0.0), (0.13, 0.05, 0.10))


def without_readings(points: np.ndarray, low: tuple[float, float], high: tuple[float, float]):
    """Points but for those over a rectangle of the floor, as the camera of `seen` sees it."""
    on_floor = points[:, :2] * (0.85 / (0.85 - points[:, 2:]))
    lost = (on_floor > low).all(axis=1) & (on_floor < high).all(axis=1)
    return points[~lost]


def test_a_body_that_returns_nothing_is_no_free_space(seen, camera):
    """All of its top is lost but for one edge, which tells how high it is."""
    points = seen([SHINY])
    hole = without_readings(points, (0.045, -0.08), (0.16, 0.08))
    observation = SceneObservation(hole, camera, gravity=DOWN, region=BIN)
    over, below = (0.08, 0.0, 0.11), (0.08, 0.0, 0.09)
    assert states(observation, over, below) == [PointState.FREE, PointState.INSIDE]
    # Deep in it, too: fingers do not get there without crossing it, but their points may skip it.
    assert states(observation, (0.08, 0.0, 0.03)) == [PointState.INSIDE]
    # Close to the hole's rim, too, where a finger beside it would go in.
    assert states(observation, (0.05, 0.0, 0.08)) == [PointState.INSIDE]
    # Beside it there are readings of the floor.
    assert states(observation, (-0.10, 0.0, 0.05)) == [PointState.FREE]
    whole = SceneObservation(points, camera, gravity=DOWN, region=BIN)
    assert states(whole, over, below, (-0.10, 0.0, 0.05)) == [
        PointState.FREE,
        PointState.INSIDE,
        PointState.FREE,
    ]


def test_narrow_holes_and_those_that_another_sensor_fills_are_none(seen, camera):
    points = seen([SHINY])
    shadow = without_readings(points, (0.0, -0.05), (0.022, 0.05))
    beside = (0.012, 0.0, 0.05)
    observation = SceneObservation(shadow, camera, gravity=DOWN, region=BIN)
    assert states(observation, beside) == [PointState.FREE]
    hole = without_readings(points, (0.045, -0.08), (0.16, 0.08))
    lost_floor = without_readings(points, (-0.15, -0.08), (-0.05, 0.08))
    views = [View(hole, camera), View(lost_floor, camera)]
    both = SceneObservation(points, camera, gravity=DOWN, region=BIN, views=views)
    assert states(both, (-0.10, 0.0, 0.0), (-0.10, 0.0, 0.02)) == [
        PointState.NEAR,
        PointState.FREE,
    ]


def test_where_the_cloud_ends_is_no_hole(seen, camera):
    points = seen([SHINY])
    # A quarter of the view is missing, and the box stands at its rim.
    cut = points[(points[:, 0] < 0.05) | (points[:, 1] < 0.0)]
    observation = SceneObservation(cut, camera, gravity=DOWN, region=BIN)
    assert states(observation, (0.16, 0.11, 0.05)) != [PointState.INSIDE]
    assert states(observation, (0.08, 0.02, 0.05)) == [PointState.INSIDE]
    # Without a region nobody knows where the scene ends.
    free = SceneObservation(without_readings(points, (0.045, -0.08), (0.16, 0.08)), camera)
    assert states(free, (0.08, 0.0, 0.09)) == [PointState.UNSEEN]


def test_walls_floor_and_the_air_above_the_walls(seen, camera):
    observation = SceneObservation(seen([TALL]), camera, gravity=DOWN, region=BIN)
    assert states(observation, (0.205, 0.0, 0.10)) == [PointState.WALL]
    assert states(observation, (0.35, 0.0, 0.10)) == [PointState.WALL]
    assert states(observation, (0.1, -0.153, 0.01)) == [PointState.WALL]
    assert states(observation, (0.205, 0.0, 0.17)) == [PointState.FREE]
    assert states(observation, (0.60, 0.0, 0.17)) == [PointState.FREE]
    assert states(observation, (0.19, 0.0, 0.10)) == [PointState.FREE]
    assert states(observation, (0.1, 0.0, -0.004)) == [PointState.FLOOR]
    assert states(observation, (0.2005, 0.0, 0.10)) == [PointState.FREE]


def test_without_walls_the_region_has_no_sides(seen, camera):
    floor = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    observation = SceneObservation(
        seen([TALL]), camera, gravity=DOWN, region=BIN, walls=False, floor=floor
    )
    assert states(observation, (0.205, 0.0, 0.10)) == [PointState.FREE]
    assert states(observation, (0.1, 0.0, -0.02)) == [PointState.FLOOR]


def test_walls_stand_upright_whatever_axis_of_the_region_points_up(seen, camera):
    turn = np.array([[0, 0, 1.0, 0], [1, 0, 0, 0], [0, 1, 0, 0.075], [0, 0, 0, 1]])
    region = OrientedBox(turn, np.array([0.30, 0.15, 0.40]))
    upright = SceneObservation(seen([TALL]), camera, gravity=DOWN, region=BIN)
    turned = SceneObservation(seen([TALL]), camera, gravity=DOWN, region=region)
    flipped_pose = np.diag([1.0, -1.0, -1.0, 1.0])
    flipped_pose[2, 3] = 0.075
    flipped = SceneObservation(
        seen([TALL]), camera, region=OrientedBox(flipped_pose, BIN.size), gravity=None
    )
    points = np.random.default_rng(0).uniform((-0.3, -0.25, -0.02), (0.3, 0.25, 0.2), (2000, 3))
    np.testing.assert_array_equal(turned.classify(points), upright.classify(points))
    np.testing.assert_array_equal(flipped.classify(points), upright.classify(points))


def test_sparse_pixels_do_not_read_as_free_through_a_surface(seen, camera):
    points = seen([TALL])
    rng = np.random.default_rng(1)
    observation = SceneObservation(points[rng.random(len(points)) < 0.3], camera, gravity=DOWN)
    below = rng.uniform((-0.15, -0.12, -0.03), (0.15, 0.12, -0.01), (3000, 3))
    assert (observation.classify(below) != PointState.FREE).all()


def test_a_patch_without_points_is_free_only_in_front_of_its_rim(seen, camera):
    points = seen([TALL])
    dark = (np.abs(points[:, 0] + 0.025) < 0.012) & (np.abs(points[:, 1]) < 0.012)
    observation = SceneObservation(points[~dark], camera, gravity=DOWN)
    assert states(observation, (-0.025, 0, 0.10)) == [PointState.FREE]
    assert states(observation, (-0.025, 0, 0.07)) == [PointState.UNSEEN]
    assert states(observation, (-0.025, 0, 0.02)) == [PointState.UNSEEN]


def test_the_result_does_not_depend_on_the_frame(seen, camera):
    points = seen([TALL])
    angle = 0.7
    rotation = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    shift = np.array([120.0, -80.0, 3.0])
    queries = np.random.default_rng(0).uniform((-0.1, -0.1, 0.0), (0.1, 0.1, 0.15), (2000, 3))
    here = SceneObservation(points, camera, gravity=DOWN).classify(queries)
    there = SceneObservation(
        points @ rotation.T + shift, rotation @ camera + shift, gravity=rotation @ DOWN
    ).classify(queries @ rotation.T + shift)
    # The raster turns with nothing, so points at the edge of a body may fall into another pixel.
    assert (here == there).mean() > 0.97


def test_distance_to_walls_and_floor(seen, camera):
    observation = SceneObservation(seen([]), camera, gravity=DOWN, region=BIN)
    points = np.array([[0.19, 0, 0.1], [0.0, 0, 0.02], [0.0, 0.147, 0.1], [0.21, 0, 0.20]])
    expected = [0.01, 0.02, 0.003, 0.05]
    np.testing.assert_allclose(observation.structure_distance(points), expected, atol=1e-6)


def test_a_sensor_inside_the_cloud_is_told(seen):
    with pytest.raises(InvalidRequestError, match="in front of it; expected a position outside"):
        SceneObservation(seen([TALL]), np.array([0.15, 0.0, 0.01]), gravity=DOWN)


def test_no_points_are_told():
    with pytest.raises(CloudError, match="0 points; expected at least 1"):
        SceneObservation(np.zeros((0, 3)), np.array([0.0, 0.0, 1.0]))

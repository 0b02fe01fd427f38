"""Floors and walls that the camera did not see are put in; dark spots on objects are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.errors import GravityError, InvalidRequestError
from megrasp_core.pointcloud import (
    Cloud,
    OrientedBox,
    Plane,
    SurfaceCloud,
    level_floor,
    surface_cloud,
    unseen_structure,
)

DOWN = np.array([0.0, 0.0, -1.0])
SENSOR = np.array([0.0, 0.0, 0.8])
BIN = OrientedBox.around((0.0, 0.0, 0.075), (0.40, 0.30, 0.15))


def top(x: float, y: float, height: float, edge: float = 0.06, pitch: float = 0.002) -> np.ndarray:
    """A level square of points."""
    axis = np.arange(-edge / 2, edge / 2, pitch)
    u, v = np.meshgrid(x + axis, y + axis)
    return np.column_stack([u.ravel(), v.ravel(), np.full(u.size, height)])


OBJECTS = np.concatenate([top(-0.1, 0.05, 0.05), top(0.08, -0.06, 0.07), top(0.05, 0.09, 0.03)])


def seen(points: np.ndarray, region: OrientedBox | None = None) -> SurfaceCloud:
    return surface_cloud(Cloud(points), sensor=SENSOR, gravity=DOWN, region=region)


def test_the_floor_and_walls_of_a_black_bin() -> None:
    found = unseen_structure(seen(OBJECTS, BIN))
    assert "taken from the region" in found.note
    height = found.points[:, 2]
    on_floor = np.abs(height) < 1e-9
    sides = np.maximum(
        np.abs(found.points[:, 0]) - 0.20 + 1e-9, np.abs(found.points[:, 1]) - 0.15 + 1e-9
    )
    assert on_floor.sum() > 3000
    assert (~on_floor).sum() > 3000
    assert (sides[~on_floor] >= 0).all()
    assert height.min() > -1e-9
    assert height.max() < 0.15


def test_what_stands_higher_than_the_crop_hides_the_floor() -> None:
    floor = top(0.0, 0.0, 0.0, edge=0.40)
    floor = floor[np.abs(floor[:, 1]) < 0.15]
    tall = top(0.0, 0.0, 0.40, edge=0.15)
    hidden = (np.abs(floor[:, :2]) < 0.075 * 0.8 / 0.4).all(axis=1)
    assert hidden.mean() > 0.6
    found = unseen_structure(seen(np.concatenate([floor[~hidden], tall]), BIN))
    assert len(found.points) == 0


def test_what_lies_behind_an_object_stays_unknown() -> None:
    found = unseen_structure(seen(OBJECTS, BIN))
    # A ray through the middle of the second object meets the floor behind it.
    hidden = SENSOR + (np.array([0.08, -0.06, 0.07]) - SENSOR) * (0.8 / 0.73)
    distance = np.linalg.norm(found.points - hidden, axis=1)
    assert distance.min() > 0.025


def test_a_floor_that_was_seen_is_left_alone() -> None:
    floor = top(0.0, 0.0, 0.0, edge=0.5)
    gap = np.linalg.norm(floor[:, :2] - (0.1, 0.1), axis=1) < 0.03
    cloud = np.concatenate([floor[~gap], OBJECTS])
    assert not len(unseen_structure(seen(cloud, BIN)).points)
    assert not len(unseen_structure(seen(cloud)).points)
    filled = unseen_structure(seen(cloud, BIN), assume_empty=True)
    near = np.linalg.norm(filled.points[:, :2] - (0.1, 0.1), axis=1) < 0.03
    assert near.sum() > 100


def test_shiny_bodies_over_most_of_a_seen_floor_are_no_look_at_it() -> None:
    floor = top(0.0, 0.0, 0.0, edge=0.5)
    lost = (np.abs(floor[:, :2]) < (0.15, 0.12)).all(axis=1)
    inside = (np.abs(floor[:, :2]) < (0.20, 0.15)).all(axis=1)
    assert 0.55 < lost[inside].mean() < 0.65
    surface = seen(floor[~lost], BIN)
    found = unseen_structure(surface)
    assert len(found.points) == 0
    assert "assume_empty" in found.note
    assert len(unseen_structure(surface, assume_empty=True).points) > 1000


def test_a_dark_spot_on_an_object_is_no_look_at_the_floor() -> None:
    box = top(0.0, 0.0, 0.08, edge=0.12)
    spot = np.linalg.norm(box[:, :2], axis=1) < 0.012
    around = unseen_structure(seen(box[~spot]), floor=level_floor(0.0, DOWN))
    assert len(around.points)
    assert np.linalg.norm(around.points[:, :2], axis=1).min() > 0.04
    everywhere = unseen_structure(
        seen(box[~spot]), floor=level_floor(0.0, DOWN), assume_empty=True
    )
    assert np.linalg.norm(everywhere.points[:, :2], axis=1).min() < 0.01


def test_an_unknown_floor_is_estimated_and_said_so() -> None:
    # Two heights, so that no top is taken for a table with nothing beneath.
    side = np.array(
        [(x, 0.12, z) for x in np.arange(0, 0.06, 0.002) for z in np.arange(0, 0.06, 0.002)]
    )
    cloud = np.concatenate([OBJECTS, side])
    found = unseen_structure(seen(cloud))
    assert "taken from the lowest points" in found.note
    assert found.floor is not None
    np.testing.assert_allclose(found.floor.normal, (0, 0, 1), atol=1e-9)
    assert abs(found.floor.offset) < 0.004
    given = unseen_structure(seen(cloud), floor=level_floor(-0.01, DOWN))
    assert "as given" in given.note
    np.testing.assert_allclose(given.points[:, 2], -0.01, atol=1e-9)


def test_the_top_of_a_flat_object_is_no_table() -> None:
    book = top(-0.05, 0.0, 0.02, edge=0.14)
    beside = np.concatenate([top(0.12, y, 0.05 + y, edge=0.05) for y in (-0.06, 0.0, 0.06)])
    surface = seen(np.concatenate([book, beside]))
    assert surface.on_plane.any(), "the plane of the book is what this is about"
    found = unseen_structure(surface)
    assert "taken from the lowest points" in found.note
    around = np.concatenate([book - (0, 0, 0.02), beside, top(0.0, 0.0, 0.0, edge=0.5)])
    assert not len(unseen_structure(seen(around)).points)


def test_the_tops_of_flat_objects_are_no_table() -> None:
    tops = [top(x, y, 0.02) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    # What is higher lies between them, as if it stood on them.
    surface = seen(np.concatenate([*tops, top(0.0, 0.0, 0.06)]))
    assert surface.on_plane.any(), "the plane of the tops is what this is about"
    assert "taken from the lowest points" in unseen_structure(surface).note


def test_the_top_of_one_flat_object_with_its_side_is_no_table() -> None:
    edge = np.arange(-0.03, 0.03, 0.002)
    side = np.array([(x, 0.06, z) for x in edge for z in np.arange(0.008, 0.025, 0.002)])
    surface = seen(np.concatenate([top(0.0, 0.0, 0.025, edge=0.12), side]))
    assert surface.on_plane.any(), "the plane of the top is what this is about"
    found = unseen_structure(surface)
    assert "taken from the lowest points" in found.note
    assert found.floor is not None
    assert abs(found.floor.offset - 0.008) < 0.004


def test_several_sensors_see_more_of_the_floor() -> None:
    box = np.concatenate([top(0.0, 0.0, 0.1, edge=0.1), top(0.0, 0.15, 0.04, edge=0.05)])
    left, right = np.array([-0.5, 0.0, 0.6]), np.array([0.5, 0.0, 0.6])
    floor = level_floor(0.0, DOWN)

    def shadow(*sensors: np.ndarray) -> int:
        cloud = Cloud(box, viewpoint=sensors[0])
        for sensor in sensors[1:]:
            cloud = cloud.joined(Cloud(box, viewpoint=sensor))
        surface = surface_cloud(cloud, gravity=DOWN)
        assert len(surface.views) == len(sensors)
        found = unseen_structure(surface, floor=floor)
        assert {tuple(row) for row in found.seen_from} <= {tuple(row) for row in sensors}
        beside = np.abs(found.points[:, 1]) < 0.03
        return int((beside & (np.abs(found.points[:, 0] - 0.09) < 0.02)).sum())

    assert shadow(right) > 50
    assert not shadow(left)
    assert shadow(left, right) > 50


def test_nothing_is_put_in_where_gravity_and_floor_are_unknown() -> None:
    surface = surface_cloud(Cloud(top(0, 0, 0.05)[:400]), sensor=SENSOR)
    found = unseen_structure(surface)
    assert found.floor is None or not len(found.points)


def test_a_wall_between_hides_the_floor() -> None:
    low = np.array([-0.9, 0.0, 0.3])
    surface = surface_cloud(Cloud(OBJECTS), sensor=low, gravity=DOWN, region=BIN)
    found = unseen_structure(surface, assume_empty=True)
    # 0.7 m away and 0.15 m over the rim, the shadow of the near wall reaches beyond the far one.
    on_floor = found.points[np.abs(found.points[:, 2]) < 1e-6]
    assert not len(on_floor)
    far_wall = found.points[np.abs(found.points[:, 0] - 0.2) < 1e-6]
    assert len(far_wall)
    assert not (np.abs(found.points[:, 0] + 0.2) < 1e-6).any()


def test_bad_floors_are_refused() -> None:
    with pytest.raises(InvalidRequestError, match=r"100 % of the cloud .* below it"):
        unseen_structure(seen(OBJECTS), floor=level_floor(0.5, DOWN))
    with pytest.raises(GravityError, match="nx ny nz d"):
        level_floor(0.1, None)


@pytest.mark.parametrize("height", [-12.0, -1.6, -0.6])
def test_a_floor_far_below_is_refused(height: float) -> None:
    with pytest.raises(InvalidRequestError, match=r"m below the lowest points.*millimetres"):
        unseen_structure(seen(OBJECTS), floor=level_floor(height, DOWN))


def test_a_floor_some_decimetres_below_one_object_is_taken() -> None:
    """A segmented object on top of a stack."""
    assert unseen_structure(seen(top(0.0, 0.0, 0.4, edge=0.05)), floor=level_floor(0.0, DOWN))


def test_a_tilted_floor() -> None:
    normal = np.array([0.1, 0.0, 1.0]) / np.linalg.norm([0.1, 0.0, 1.0])
    floor = Plane(normal, 0.0)
    found = unseen_structure(seen(OBJECTS), floor=floor)
    np.testing.assert_allclose(floor.height(found.points), 0.0, atol=1e-9)


def test_a_region_as_large_as_a_hall_takes_no_memory() -> None:
    """A square of 10 km has 6 million million points of 4 mm."""
    hall = OrientedBox.around((0.0, 0.0, 5e3 - 1e-4), (1e4, 1e4, 1e4))
    found = unseen_structure(seen(OBJECTS, hall), assume_empty=True)
    assert len(found.points) <= 5_100_000


def test_a_tilted_floor_that_was_seen_is_left_alone() -> None:
    floor = np.concatenate([top(0.0, 0.0, 0.0, edge=0.5), OBJECTS])
    turn = Rotation.from_euler("x", 0.35).as_matrix()
    assert unseen_structure(seen(floor @ turn.T)).note == ""

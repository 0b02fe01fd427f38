"""Bins are found where they are, and nowhere else."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from bin_clouds import (
    ABOVE,
    ASIDE,
    DOWN,
    bin_meshes,
    block,
    contents,
    pose,
    seen,
    table,
)

from megrasp_core.benchmarks.bins import pose_error
from megrasp_core.errors import CloudError, GravityError, InvalidRequestError, NoBinError
from megrasp_core.pointcloud import Cloud, FoundBin, OrientedBox, find_bin


def assert_found(found: FoundBin, true: OrientedBox, *, depth: float | None = 0.004) -> None:
    """Hold pose, edges and, unless None, the depth (m) against the truth."""
    distance, angle, size = pose_error(found.box, true)
    assert distance < 0.005 and angle < 1.0
    assert np.abs(size[:2]).max() < 0.006
    assert depth is None or abs(size[2]) < depth
    assert found.box.rotation[:, 2] @ DOWN < -0.9


@cache
def empty_bin() -> tuple[Cloud, OrientedBox]:
    meshes, inside = bin_meshes(pose(0.02, -0.03, 0.004, yaw=25))
    return seen([*meshes, table()]), inside


@pytest.mark.parametrize("camera", [ABOVE, ASIDE], ids=["above", "aside"])
@pytest.mark.parametrize("yaw", [0, 25, 90, -40])
def test_an_empty_bin(yaw: int, camera: np.ndarray) -> None:
    meshes, inside = bin_meshes(pose(0.02, -0.03, 0.004, yaw=yaw))
    found = find_bin(seen([*meshes, table()], camera), DOWN)
    assert_found(found, inside)
    assert found.empty and found.fill_level < 0.02 and found.depth_from == "floor"
    assert found.seen > 0.8 and found.rim_error < 0.002
    assert found.box.size[0] > found.box.size[1]


@pytest.mark.parametrize("tilt", [5, 10])
def test_a_tilted_bin(tilt: int) -> None:
    meshes, inside = bin_meshes(pose(z=0.05, yaw=30, tilt=tilt))
    found = find_bin(seen([*meshes, table()]), DOWN)
    assert_found(found, inside)


def test_a_bin_with_a_ledge_and_one_without_a_table() -> None:
    meshes, inside = bin_meshes(pose(z=0.004, yaw=-15), ledge=0.02)
    assert_found(find_bin(seen([*meshes, table()]), DOWN), inside)
    assert_found(find_bin(seen(meshes), DOWN), inside)


def test_the_frame_and_its_origin_do_not_matter() -> None:
    cloud, inside = empty_bin()
    motion = pose(3.0, -1.0, 2.0, yaw=70, tilt=140)
    found = find_bin(cloud.transformed(motion), motion[:3, :3] @ DOWN)
    distance, angle, size = pose_error(found.box, inside.transformed(motion))
    assert distance < 0.003 and angle < 0.5 and np.abs(size).max() < 0.004
    assert found.empty


def test_equal_clouds_give_equal_bins() -> None:
    cloud, _ = empty_bin()
    first, second = find_bin(cloud, DOWN), find_bin(cloud, DOWN)
    np.testing.assert_array_equal(first.box.world_from_box, second.box.world_from_box)
    np.testing.assert_array_equal(first.cells, second.cells)


def test_holes_of_a_depth_image_do_not_matter() -> None:
    cloud, inside = empty_bin()
    points = cloud.points.copy()
    points[np.random.default_rng(0).random(len(points)) < 0.3] = np.nan
    assert_found(find_bin(Cloud(points, None, cloud.viewpoint), DOWN), inside)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1, 1])
def test_one_wall_may_be_missing(axis: int, sign: int) -> None:
    cloud, inside = empty_bin()
    local = inside.local(cloud.points)
    beyond = sign * local[:, axis] - inside.size[axis] / 2
    wall = (beyond > -0.002) & (beyond < 0.02) & (local[:, 2] > 0.003 - inside.size[2] / 2)
    found = find_bin(cloud.select(~wall), DOWN)
    assert_found(found, inside)
    assert np.sort(found.walls_seen)[0] < 0.2 < np.sort(found.walls_seen)[1]


def test_two_walls_are_not_enough() -> None:
    cloud, inside = empty_bin()
    local = inside.local(cloud.points)
    walls = (np.abs(local[:, 0]) > 0.195) & (local[:, 2] > -0.07)
    walls |= (local[:, 1] > 0.02) & (local[:, 2] > -0.07)
    with pytest.raises(NoBinError):
        find_bin(cloud.select(~walls), DOWN)


def test_a_black_floor_is_taken_from_the_table() -> None:
    cloud, inside = empty_bin()
    local = inside.local(cloud.points)
    floor = (np.abs(local[:, :2]) < inside.size[:2] / 2).all(axis=1) & (local[:, 2] < -0.06)
    found = find_bin(cloud.select(~floor), DOWN)
    assert_found(found, inside, depth=0.006)
    assert found.depth_from == "surroundings" and found.empty and found.fill_level < 0.05


@pytest.mark.parametrize(
    ("height", "low", "high"), [(0.06, 0.25, 0.5), (0.14, 0.75, 1.0), (0.20, 0.9, 1.0)]
)
def test_full_and_overfull_bins(height: float, low: float, high: float) -> None:
    meshes, inside = bin_meshes(pose(z=0.004, yaw=10))
    heap = contents(inside, height, count=150)
    found = find_bin(seen([*meshes, *heap, table()]), DOWN)
    assert_found(found, inside, depth=0.008)
    assert not found.empty and low < found.fill_level <= high
    assert height < 0.15 or np.nanmax(found.cells) > 1.0


def test_cells_are_rows_along_y_and_columns_along_x() -> None:
    meshes, inside = bin_meshes(pose(z=0.004, yaw=20))
    # 10 cm high in the corner of low x and high y.
    corner = block((-0.19, 0.06, -0.075), (-0.11, 0.14, 0.025)).moved(inside.world_from_box)
    found = find_bin(seen([*meshes, corner, table()]), DOWN)
    assert_found(found, inside)
    rows, columns = found.cells.shape
    assert (rows, columns) == (6, 8)
    # The axes of the box that was found may point the other way.
    local = found.box.local((inside.world_from_box @ [-0.15, 0.10, 0.0, 1.0])[None, :3])[0]
    column, row = np.floor((local[:2] / found.box.size[:2] + 0.5) * [columns, rows]).astype(int)
    assert found.cells[row, column] == pytest.approx(10 / 15, abs=0.1)
    assert found.cells[rows - 1 - row, columns - 1 - column] < 0.05
    assert not found.empty and 0.02 < found.fill_level < 0.12


def test_x_is_the_longer_edge_or_the_one_that_was_given_first() -> None:
    cloud, inside = empty_bin()
    np.testing.assert_allclose(find_bin(cloud, DOWN).box.size, inside.size, atol=0.005)
    turned = find_bin(cloud, DOWN, size=(0.30, 0.40, 0.15))
    np.testing.assert_array_equal(turned.box.size, [0.30, 0.40, 0.15])
    assert turned.depth_from == "size"
    assert_found(turned, inside)


def test_a_size_that_contradicts_the_cloud_is_named_with_what_is_there() -> None:
    cloud, _ = empty_bin()
    with pytest.raises(NoBinError, match=r"0\.6 x 0\.4 m was found, but one of 0\.\d+ x 0\.\d+"):
        find_bin(cloud, DOWN, size=(0.6, 0.4, 0.2))


def test_of_two_bins_the_one_of_the_given_size() -> None:
    large, inside = bin_meshes(pose(-0.24, 0.0, 0.004))
    small, other = bin_meshes(pose(0.20, 0.0, 0.004, yaw=12), (0.26, 0.20, 0.10))
    cloud = seen([*large, *small, table()], np.array([0.0, 0.0, 1.2]))
    assert_found(find_bin(cloud, DOWN, size=inside.size), inside)
    assert_found(find_bin(cloud, DOWN, size=other.size), other)
    distances = [pose_error(find_bin(cloud, DOWN).box, one)[0] for one in (inside, other)]
    assert min(distances) < 0.005


def test_a_bin_among_boxes_of_its_height() -> None:
    meshes, inside = bin_meshes(pose(z=0.004, yaw=20))
    rng = np.random.default_rng(3)
    for angle in rng.uniform(0, 2 * np.pi, 5):
        size = rng.uniform(0.06, 0.15, 3)
        place = pose(0.38 * np.cos(angle), 0.38 * np.sin(angle), size[2] / 2, yaw=50 * angle)
        meshes.append(block(-size / 2, size / 2).moved(place))
    assert_found(find_bin(seen([*meshes, table()]), DOWN), inside)


def test_no_bin_on_an_empty_table_or_a_part_of_it() -> None:
    cloud = seen([table()])
    with pytest.raises(NoBinError, match="expected a rectangular one with inner edges of"):
        find_bin(cloud, DOWN)
    hole = (np.abs(cloud.points[:, :2]) < [0.2, 0.15]).all(axis=1)
    with pytest.raises(NoBinError):
        find_bin(cloud.select(~hole), DOWN)
    with pytest.raises(NoBinError):
        find_bin(cloud.select(hole), DOWN)


@pytest.mark.parametrize("camera", [ABOVE, ASIDE], ids=["above", "aside"])
@pytest.mark.parametrize("seed", range(5))
def test_no_bin_on_a_table_with_boxes(seed: int, camera: np.ndarray) -> None:
    rng = np.random.default_rng(seed)
    meshes = [table()]
    for _ in range(12):
        size = rng.uniform(0.03, 0.25, 3)
        place = pose(*rng.uniform(-0.3, 0.3, 2), size[2] / 2, yaw=rng.uniform(0, 180))
        meshes.append(block(-size / 2, size / 2).moved(place))
    with pytest.raises(NoBinError):
        find_bin(seen(meshes, camera), DOWN)


def test_a_closed_carton_is_no_bin() -> None:
    carton = block((-0.2, -0.15, 0.0), (0.2, 0.15, 0.2))
    for camera in (ABOVE, ASIDE):
        with pytest.raises(NoBinError):
            find_bin(seen([carton, table()], camera), DOWN)


def test_a_box_that_is_too_small_is_no_bin() -> None:
    meshes, _ = bin_meshes(pose(z=0.004), (0.10, 0.08, 0.05))
    with pytest.raises(NoBinError):
        find_bin(seen([*meshes, table()]), DOWN)


def test_where_nothing_is_known_cells_are_unknown() -> None:
    """Without the place of the sensor nobody can say whether a hole is dark floor or hidden."""
    cloud, inside = empty_bin()
    local = inside.local(cloud.points)
    hole = (local[:, 0] < 0.0) & (local[:, 0] > -0.19) & (np.abs(local[:, 1]) < 0.14)
    holed = cloud.select(~(hole & (local[:, 2] < -0.05)))
    known = find_bin(holed, DOWN)
    blind = find_bin(Cloud(holed.points), DOWN)
    assert_found(blind, inside)
    assert np.isfinite(known.cells).all() and known.fill_level < 0.02
    assert 0.2 < np.isnan(blind.cells).mean() < 0.6


def test_wrong_arguments_are_named() -> None:
    cloud, _ = empty_bin()
    with pytest.raises(GravityError, match="not a direction"):
        find_bin(cloud, (0, 0, 0))
    with pytest.raises(InvalidRequestError, match="three inner edges"):
        find_bin(cloud, DOWN, size=(0.4, 0.3))
    with pytest.raises(InvalidRequestError, match="three inner edges"):
        find_bin(cloud, DOWN, size=(0.4, 0.0, 0.1))
    with pytest.raises(CloudError, match="none of the 5 points is finite"):
        find_bin(Cloud(np.full((5, 3), np.nan)), DOWN)
    with pytest.raises(NoBinError, match="covers less than a bin"):
        find_bin(Cloud(0.05 * np.random.default_rng(0).random((500, 3))), DOWN)

"""The cloud itself and the box around it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from megrasp_core.errors import CloudError, InvalidRequestError
from megrasp_core.pointcloud import Cloud, OrientedBox

COORDINATE = st.floats(-2, 2, allow_nan=False)
VECTOR = st.tuples(COORDINATE, COORDINATE, COORDINATE)


def pose(rotation: tuple[float, ...], translation: tuple[float, ...]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    matrix[:3, 3] = translation
    return matrix


@given(VECTOR, VECTOR, st.tuples(*[st.floats(0.01, 1)] * 3), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_box_holds_what_lies_between_its_faces(rotation, translation, size, seed) -> None:
    box = OrientedBox(pose(rotation, translation), np.array(size))
    inside = np.random.default_rng(seed).uniform(-0.499, 0.499, (50, 3)) * size
    world = inside @ box.rotation.T + box.centre
    assert box.contains(world).all()
    axis = seed % 3
    outside = inside.copy()
    outside[:, axis] = np.sign(inside[:, axis] + 1e-9) * size[axis] * 0.501
    moved = outside @ box.rotation.T + box.centre
    assert not box.contains(moved).any()
    assert box.grown(0.01).contains(moved).all()
    np.testing.assert_allclose(box.local(world), inside, atol=1e-12)
    assert box.grown(1e-9).contains(box.corners()).all()
    assert not box.grown(-1e-3).contains(box.corners()).any()


@given(VECTOR, VECTOR, VECTOR)
@settings(max_examples=60, deadline=None)
def test_crop_moves_with_the_frame(rotation, translation, other) -> None:
    box = OrientedBox(pose(rotation, translation), np.array([0.3, 0.4, 0.5]))
    points = np.random.default_rng(3).uniform(-0.6, 0.6, (200, 3)) + translation
    margin = np.abs(np.abs(box.local(points)) - box.size / 2).min(axis=1) > 1e-9
    motion = pose(other, rotation)
    moved = Cloud(points).transformed(motion).points
    same = box.transformed(motion).contains(moved) == box.contains(points)
    assert same[margin].all()


def test_box_keeps_out_what_is_not_finite() -> None:
    box = OrientedBox.around([0, 0, 0], [1, 1, 1])
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]])
    with np.errstate(all="raise"):
        assert box.contains(points).tolist() == [True, False, False, False]


@pytest.mark.parametrize("direction", [(0, 0, 1), (0.1, -0.2, -0.9), (-1, 0.3, 0), (0, 1, 0.2)])
def test_extended_moves_one_face_only(direction: tuple[float, ...]) -> None:
    box = OrientedBox(pose((0.1, 0.2, -0.1), (1, 2, 3)), np.array([0.2, 0.3, 0.4]))
    taller = box.extended(direction, 0.1)
    axis, sign = box.face_towards(direction)
    before, after = box.local(box.corners()), box.local(taller.corners())
    change = after - before
    assert np.allclose(np.delete(change, axis, axis=1), 0)
    grew = np.sign(before[:, axis]) == sign
    np.testing.assert_allclose(change[grew, axis], 0.1 * sign)
    np.testing.assert_allclose(change[~grew, axis], 0, atol=1e-12)


def test_bad_boxes_are_refused() -> None:
    with pytest.raises(InvalidRequestError, match=r"box size \[0.1, 0.0, 0.1\].*over 0"):
        OrientedBox.around([0, 0, 0], [0.1, 0.0, 0.1])
    with pytest.raises(InvalidRequestError, match="orthonormal"):
        OrientedBox(2 * np.eye(4), np.ones(3))
    with pytest.raises(InvalidRequestError, match=r"shape \(3, 3\)"):
        OrientedBox(np.eye(3), np.ones(3))


def test_cloud_checks_shapes() -> None:
    with pytest.raises(CloudError, match=r"shape \(3,\); expected \(N, 3\)"):
        Cloud(np.zeros(3))
    with pytest.raises(CloudError, match=r"colors have the shape \(2, 3\)"):
        Cloud(np.zeros((3, 3)), np.zeros((2, 3)))
    with pytest.raises(CloudError, match="not numbers"):
        Cloud([["a", "b", "c"]])  # pyright: ignore[reportArgumentType]


def test_select_and_transform_carry_colours_and_views() -> None:
    points, colors, views = (np.arange(12.0).reshape(4, 3) + k for k in range(3))
    cloud = Cloud(points, colors, views).select(np.array([2, 0]))
    for got, source in ((cloud.points, points), (cloud.colors, colors), (cloud.viewpoint, views)):
        np.testing.assert_array_equal(got, source[[2, 0]])
    motion = pose((0, 0, np.pi / 2), (1, 0, 0))
    moved = Cloud(points, None, np.array([1.0, 2.0, 3.0])).transformed(motion)
    np.testing.assert_allclose(moved.viewpoint, [-1, 1, 3])
    np.testing.assert_allclose(moved.points[1], [1 - 4, 3, 5])


def test_a_region_in_millimetres_is_refused_and_a_roomy_one_is_told() -> None:
    OrientedBox.around((0, 0, 0), (99.0, 1.0, 1.0)).check_units()
    with pytest.raises(InvalidRequestError, match=r"400 x 300 x 150.*looks like millimetres"):
        OrientedBox.around((0, 0, 0), (400.0, 300.0, 150.0)).check_units()
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))
    assert not OrientedBox.around((0, 0, 0), (3.0, 3.0, 1.0)).doubt(points)
    assert "metres" in OrientedBox.around((0, 0, 0), (40.0, 30.0, 15.0)).doubt(points)
    assert not OrientedBox.around((9, 9, 9), (4.0, 3.0, 1.0)).doubt(points), "there is nothing"

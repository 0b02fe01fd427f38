"""Pictures of clouds and grasps: what is drawn is where it belongs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from megrasp_core.drawing.grasp_picture import HEADER, PANEL, draw_grasps, rank_colour
from megrasp_core.drawing.splat import Canvas, Projection, look_along
from megrasp_core.grippers import load_gripper
from megrasp_core.pointcloud import Cloud, OrientedBox

REGION = OrientedBox.around((0.0, 0.0, 0.075), (0.40, 0.30, 0.15))


@pytest.fixture(scope="module")
def gripper():
    return load_gripper("franka_hand")


def cloud() -> Cloud:
    rng = np.random.default_rng(0)
    floor = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (40000, 3))
    box = rng.uniform((0.05, 0.03, 0.06), (0.11, 0.09, 0.0605), (8000, 3))
    return Cloud(np.concatenate([floor, box]), None, np.array([0.0, 0.0, 0.85]))


def grasp(gripper, x: float, y: float, score: float) -> SimpleNamespace:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = np.array([x, y, 0.05]) - pose[:3, :3] @ gripper.tcp
    return SimpleNamespace(world_from_gripper=pose, score=score)


def panels(image) -> tuple[np.ndarray, np.ndarray]:
    pixels = np.asarray(image).astype(int)[HEADER:]
    return pixels[:, : PANEL[0]], pixels[:, -PANEL[0] :]


def where(difference: np.ndarray) -> np.ndarray:
    """Mean (column, row) of the pixels that changed."""
    rows, columns = np.nonzero(difference > 40)
    return np.array([columns.mean(), rows.mean()])


@pytest.mark.slow
def test_the_top_view_shows_x_to_the_right_and_y_upwards(gripper):
    empty = panels(draw_grasps(cloud(), [], gripper, region=REGION))[0]
    middle = np.array(PANEL) / 2
    for x, y in ((0.1, 0.0), (0.0, 0.1), (-0.12, -0.08)):
        drawn = draw_grasps(cloud(), [grasp(gripper, x, y, 0.9)], gripper, region=REGION)
        offset = where(np.abs(panels(drawn)[0] - empty).sum(axis=-1)) - middle
        scale = PANEL[0] / (1.08 * 0.40)
        np.testing.assert_allclose(offset, [x * scale, -y * scale], atol=0.02 * scale)


@pytest.mark.slow
def test_the_chosen_gripper_is_drawn_and_none_where_none_is_chosen(gripper):
    ranked = [grasp(gripper, 0.1, 0.05, 0.9), grasp(gripper, -0.1, -0.05, 0.5)]
    without, first, second = (
        panels(draw_grasps(cloud(), ranked, gripper, region=REGION, chosen=chosen))[1]
        for chosen in (None, 0, 1)
    )
    changed = [where(np.abs(image - without).sum(axis=-1)) for image in (first, second)]
    assert np.linalg.norm(changed[0] - changed[1]) > 100
    out_of_range = draw_grasps(cloud(), ranked, gripper, region=REGION, chosen=7)
    np.testing.assert_array_equal(panels(out_of_range)[1], without)


def test_nan_points_and_a_cloud_with_colours_are_drawn(gripper):
    points = cloud().points.copy()
    points[::7] = np.nan
    colours = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    top, _ = panels(draw_grasps(Cloud(points, colours), [], gripper))
    red = (top[..., 0] > 60) & (top[..., 1] < 40) & (top[..., 2] < 40)
    assert red.mean() > 0.3


def test_rank_colours_go_from_green_to_red():
    first, last = rank_colour(0, 5), rank_colour(4, 5)
    assert first[1] > 0.7 > 0.2 > first[0] and last[0] > 0.9 > 0.2 > last[1]
    assert rank_colour(0, 1).shape == (3,)


def test_the_nearest_point_wins_whatever_the_order():
    view = Projection(
        look_along(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])), np.zeros(3), 100, (9, 9)
    )
    near, far = np.array([[0.0, 0.0, 0.2]]), np.array([[0.0, 0.0, 0.1]])
    for order in ((near, far), (far, near)):
        canvas = Canvas(view)
        for points in order:
            canvas.draw(points, [1.0, 0.0, 0.0] if points is near else [0.0, 0.0, 1.0])
        assert canvas.image()[4, 4].tolist() == [255, 0, 0]

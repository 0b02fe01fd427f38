"""Units, frames and gravity that cannot be what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.errors import CloudError, GravityError
from megrasp_core.pointcloud import OrientedBox, check_view

RNG = np.random.default_rng(0)
TABLE = np.column_stack([RNG.uniform(-0.4, 0.4, (4000, 2)), RNG.uniform(0.0, 0.1, 4000)])
"""World frame, z up."""
SEEN = np.column_stack([RNG.uniform(-0.4, 0.4, (4000, 2)), RNG.uniform(0.7, 0.8, 4000)])
"""Camera frame, z forward."""
DOWN = (0.0, 0.0, -1.0)


def test_ordinary_clouds_pass() -> None:
    check_view(TABLE, sensor=(0, 0, 0.8), gravity=DOWN)
    check_view(TABLE, sensor=(-0.9, 0, 0.06), gravity=DOWN)
    check_view(SEEN, sensor=(0, 0, 0), gravity=(0, 0, 9.81), optical=True)
    check_view(TABLE)
    check_view(np.full((5, 3), np.nan), sensor=(0, 0, 1), gravity=DOWN)


@pytest.mark.parametrize(
    ("scale", "name"), [(0.001, "millimetres"), (0.01, "centimetres"), (0.0254, "inches")]
)
@pytest.mark.parametrize("sensor", [None, (0.0, 0.0, 0.0)])
def test_other_units_are_named(
    scale: float, name: str, sensor: tuple[float, float, float] | None
) -> None:
    place = None if sensor is None else np.asarray(sensor)
    with pytest.raises(CloudError, match=rf"{name}: scale it by {scale} \(--scale {scale}\)"):
        check_view(SEEN / scale, sensor=place, gravity=(0, 0, 1), optical=True)


def test_a_small_part_in_millimetres() -> None:
    part = 0.05 * SEEN / 0.001
    with pytest.raises(CloudError, match="millimetres"):
        check_view(part + np.array([0, 0, 500]), sensor=(0, 0, 0))


def test_a_hall_with_a_region_is_no_other_unit() -> None:
    hall = np.concatenate([TABLE, RNG.uniform(-30, 30, (20000, 3))])
    check_view(hall, gravity=DOWN, region=OrientedBox.around((0, 0, 0.1), (0.6, 0.6, 0.3)))
    with pytest.raises(CloudError, match="give the region"):
        check_view(hall, gravity=DOWN)


def test_a_region_in_the_cloud_s_millimetres() -> None:
    with pytest.raises(CloudError, match="millimetres"):
        check_view(1000 * TABLE, region=OrientedBox.around((0, 0, 100), (600, 600, 300)))


def test_a_scene_of_no_size() -> None:
    with pytest.raises(CloudError, match="at least 3 mm"):
        check_view(0.001 * TABLE)


def test_far_from_the_origin_in_32_bits() -> None:
    far = TABLE + np.array([4e5, 5.8e6, 110.0])
    check_view(far)
    with pytest.raises(CloudError, match=r"500 mm apart.*store 64 bits"):
        check_view(far.astype(np.float32).astype(np.float64))


def test_points_behind_a_camera() -> None:
    with pytest.raises(CloudError, match=r"all points lie behind the camera.*Turn y and z round"):
        check_view(SEEN * (1, -1, -1), sensor=(0, 0, 0), gravity=(0, 0, 1), optical=True)
    half = np.where(np.arange(4000)[:, None] % 2, SEEN, -SEEN)
    with pytest.raises(CloudError, match="50 % of the points lie behind"):
        check_view(half, sensor=(0, 0, 0), optical=True)


def test_an_accelerometer_s_vector() -> None:
    up = np.array([0.0, -6.51, -7.33])
    with pytest.raises(GravityError, match=r"gravity 0 -6.51 -7.33 .* use 0 6.51 7.33"):
        check_view(SEEN, sensor=(0, 0, 0), gravity=up, optical=True)
    check_view(SEEN, sensor=(0, 0, 0), gravity=-up, optical=True)


def test_camera_axes_that_nobody_named() -> None:
    with pytest.raises(GravityError, match=r"seems to be a camera's.*Give gravity"):
        check_view(SEEN, sensor=(0, 0, 0), gravity=DOWN)


def test_one_sensor_place_a_point() -> None:
    places = np.tile((0.0, 0.0, -0.8), (len(TABLE), 1))
    with pytest.raises(GravityError):
        check_view(TABLE, sensor=places, gravity=DOWN)


def test_a_sensor_in_other_units_or_another_frame_is_named() -> None:
    with pytest.raises(CloudError, match=r"sensor, at 0 0 800, .* Check where the sensor"):
        check_view(TABLE, sensor=(0, 0, 800), gravity=DOWN)


def test_marks_of_missing_readings_are_named() -> None:
    marked = np.concatenate([TABLE, np.full((300, 3), 1e5)])
    with pytest.raises(CloudError, match=r"7 % of its points .* without a reading"):
        check_view(marked, sensor=(0, 0, 0.8), gravity=DOWN)


def test_every_sensor_is_looked_at() -> None:
    both = np.concatenate([TABLE, TABLE])
    places = np.repeat([[0.0, 0.3, 0.8], [0.0, -0.3, 0.7]], len(TABLE), axis=0)
    check_view(both, sensor=places, gravity=DOWN)
    places[len(TABLE) :, 2] = -0.5
    with pytest.raises(GravityError, match=r"sensor at 0 -0\.3 -0\.5 lies below"):
        check_view(both, sensor=places, gravity=DOWN)

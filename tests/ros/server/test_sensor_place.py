"""Where the camera is: the parameter `sensor_origin` is named where the core finds it wrong."""

from __future__ import annotations

import numpy as np
import pytest
from megrasp_msgs.msg import ErrorCode
from server_client import table_points

from megrasp_core.errors import GravityError, SensorPlaceError
from megrasp_core.pointcloud import DepthImage, check_view
from megrasp_ros.errors import SensorOriginError, describe, in_ros_words
from megrasp_ros.server.sensing import placed

ORIGIN = [0.0, 0.0, 0.0]


def test_a_place_amid_the_cloud_is_told_of_the_parameter() -> None:
    with (
        pytest.raises(SensorOriginError, match=r"sensor_origin is not set.*'world'") as told,
        placed("world", ORIGIN),
    ):
        DepthImage(table_points(), np.zeros(3))
    code, text = describe(told.value)
    assert code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING
    assert text.index("sensor_origin") < text.index("sensor position")
    with (
        pytest.raises(SensorOriginError, match=r"sensor_origin is 0\.1 0 0"),
        placed("world", [0.1, 0, 0]),
    ):
        DepthImage(table_points(), np.array([0.1, 0.0, 0.0]))


def test_a_place_below_is_told_of_it_only_where_it_was_not_given() -> None:
    above, down = table_points() + np.array((0.0, 0.0, 1.0)), (0.0, 0.0, -1.0)
    with (
        pytest.raises(SensorOriginError, match="sensor_origin is not set"),
        placed("world", ORIGIN),
    ):
        check_view(above, sensor=ORIGIN, gravity=down)
    with pytest.raises(GravityError), placed("world", [0.0, 0.0, 0.1]):
        check_view(above, sensor=(0.0, 0.0, 0.1), gravity=down)
    with pytest.raises(GravityError), placed("", ORIGIN):
        check_view(above, sensor=ORIGIN, gravity=down)
    with pytest.raises(SensorPlaceError), placed("", ORIGIN):
        DepthImage(table_points(), np.zeros(3))


def test_options_of_the_command_line_are_no_advice_for_a_node() -> None:
    with pytest.raises(Exception, match=r"--scale 0\.001") as told:
        check_view(1000 * table_points(), sensor=(0.0, 0.0, 600.0))
    words = in_ros_words(str(told.value))
    assert "--scale" not in words and "metres (REP 103)" in words and "16UC1" in words
    assert in_ros_words("no option") == "no option"

"""Requests are checked, and a large one within its time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose
from megrasp_msgs.srv import SynthesizeGrasps

from megrasp_core.errors import InvalidRequestError, RequestTimeoutError
from megrasp_ros.server.requests import checked_request

SETTINGS: Any = SimpleNamespace(
    max_num_grasps=100,
    max_tilt=np.pi,
    request_timeout=60.0,
    region=None,
    min_score=0.0,
    prefer="score",
)


def poses(count: int) -> list[Pose]:
    made = [Pose(position=Point(x=float(i))) for i in range(count)]
    for pose in made:
        pose.orientation.w = 1.0
    return made


def test_excluded_poses_are_read_in_one_go() -> None:
    request = checked_request(SynthesizeGrasps.Request(exclude=poses(3)), SETTINGS)
    excluded = request.excluded(lambda: None)
    assert excluded.shape == (3, 4, 4)
    np.testing.assert_array_equal(excluded[:, 0, 3], [0.0, 1.0, 2.0])
    for attribute in ("orientation.w", "position.y"):
        wrong = poses(3)
        part, name = attribute.split(".")
        setattr(getattr(wrong[1], part), name, 0.0 if name == "w" else 1e300)
        request = checked_request(SynthesizeGrasps.Request(exclude=wrong), SETTINGS)
        with pytest.raises(InvalidRequestError, match=r"exclude\[1\] is .*unit quaternion"):
            request.excluded(lambda: None)


def test_reading_many_poses_ends_with_the_time_of_the_request() -> None:
    request = checked_request(SynthesizeGrasps.Request(exclude=poses(5000)), SETTINGS)
    asked = 0

    def check() -> None:
        nonlocal asked
        asked += 1
        if asked == 3:
            raise RequestTimeoutError("over")

    with pytest.raises(RequestTimeoutError):
        request.excluded(check)
    assert asked == 3


def test_options_of_a_request_go_before_parameters() -> None:
    plain = checked_request(SynthesizeGrasps.Request(), SETTINGS)
    assert (plain.target, plain.min_score, plain.mode, plain.prefer) == (
        None,
        0.0,
        "default",
        "score",
    )
    given = SynthesizeGrasps.Request(target=3, min_score=0.5, mode="fast", prefer="high")
    request = checked_request(given, SETTINGS)
    assert (request.target, request.min_score, request.mode, request.prefer) == (
        3,
        0.5,
        "fast",
        "high",
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"target": 0}, "target is 0"),
        ({"min_score": 1.5}, "min_score is 1.5"),
        ({"min_score": float("nan")}, "min_score is nan"),
        ({"mode": "slow"}, "default, fast"),
        ({"prefer": "x" * 5000}, "score, high, clear"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words) as told:
        checked_request(SynthesizeGrasps.Request(**options), SETTINGS)
    assert len(str(told.value)) < 2000

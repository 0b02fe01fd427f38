"""Options as JSON: whatever comes is taken for what it is, or refused with words."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from megrasp_core.errors import MegraspError
from megrasp_core.service.wire import request_of
from megrasp_core.synthesizer import SynthesisRequest

POSE = [0, 0, 0, 0, 0, 0, 1]
VALUES = [
    *(json.loads(text) for text in ("null", "true", "false", "NaN", "Infinity", "-Infinity")),
    0, 1, -1, 0.5, 10**400, "", "x", "0.5", "false", [], [1], [1, 2, 3], [1, 2, 3, 4], [True] * 3,
    ["1", "2", "3"], [None], [None] * 3, [[1, 2], [3]], [[1]], [[0, 0, 1]], [10**400] * 3,
    [1e300] * 3, [POSE], [[0] * 7], [[POSE]], [["0"] * 7], {}, {"a": 1}, {"pose": POSE},
    {"pose": 1, "size": 1}, {"pose": POSE, "size": [1, "1", 1]}, {"pose": POSE, "size": [1] * 3},
    {"pose": POSE, "size": [10**400] * 3}, {"pose": [POSE], "size": [1] * 3},
]  # fmt: skip
NUMBERS = {
    "num_grasps", "drawn", "max_tilt", "approach_distance", "exclude_radius", "seed", "target",
    "min_score",
}  # fmt: skip
SWITCHES = {"walls", "assume_empty", "keep_all"}
OPTIONS = [field.name for field in dataclasses.fields(SynthesisRequest)]


@pytest.mark.parametrize("name", OPTIONS)
def test_every_option_takes_values_of_its_kind_and_refuses_others_with_words(name: str) -> None:
    default = getattr(SynthesisRequest(), name)
    taken = []
    for value in VALUES:
        try:
            request = request_of({name: value})
        except MegraspError as error:
            assert "expected" in str(error)
            continue
        taken.append(value)
        made = getattr(request, name)
        if name in SWITCHES:
            assert made is value
        elif name in NUMBERS:
            assert made is None or (not isinstance(value, bool) and np.isfinite(float(made)))
        elif value is not None:
            assert isinstance(made, type(default)) or default is None
    strings = [value for value in taken if isinstance(value, str)]
    assert not strings
    assert taken or isinstance(default, str)

"""Settings outside their ranges are refused where they are made."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.errors import InvalidRequestError, SimulationError
from megrasp_core.pointcloud import DepthImageSettings, SceneSettings
from megrasp_core.ranges import COUNT, POSITIVE, SHARE, Range
from megrasp_core.ranking import CheckSettings, ContactSettings, RankSettings, SweepSettings
from megrasp_core.simulation import DepthNoise, Variation
from megrasp_core.synthesizer import SynthesizerSettings
from megrasp_core.training import FinetuneConfig, TrainConfig


@pytest.mark.parametrize(
    ("settings", "given"),
    [
        (CheckSettings, {"approach_steps": 0}),
        (CheckSettings, {"max_unseen": np.nan}),
        (ContactSettings, {"percentile": 70}),
        (ContactSettings, {"max_points": -1}),
        (RankSettings, {"full_clearance": 0.0}),
        (SweepSettings, {"back_off": (0.003, -0.006)}),
        (DepthNoise, {"steep": (0.1, 0.1)}),
        (DepthNoise, {"edge_loss": -3}),
        (DepthNoise, {"correlated": 2}),
        (DepthImageSettings, {"max_side": 0}),
        (FinetuneConfig, {"warmup_steps": 0}),
        (FinetuneConfig, {"ema_decay": 1.0}),
        (TrainConfig, {"gradient_clip": "1"}),
        (TrainConfig, {"low_levels": 1.0}),
        (SamplerSettings, {"steps": 2.5}),
        (SceneSettings, {"voxel": 4.0}),
        (SynthesizerSettings, {"refined": -1}),
    ],
)
def test_a_setting_outside_its_range_is_refused_by_name(
    settings: type, given: dict[str, Any]
) -> None:
    settings()
    [(name, value)] = given.items()
    with pytest.raises(InvalidRequestError, match=re.escape(f"{name} {value}"[:12])) as told:
        settings(**given)
    assert "expected" in str(told.value)


def test_all_that_is_wrong_is_told_at_once_and_as_the_error_of_the_place() -> None:
    with pytest.raises(SimulationError, match=r"friction -1 was.*mass nan was.* over 0, or none"):
        Variation(friction=-1, mass=float("nan"))


@pytest.mark.parametrize(
    ("allowed", "taken", "refused"),
    [
        (COUNT, [0, 7, np.int64(3)], [-1, 1.0, True, "1", None, [1]]),
        (SHARE, [0, 1, 0.5, np.float32(0.5)], [1.001, np.nan, np.inf, False, 10**400]),
        (POSITIVE, [1e-300, 7], [0, np.inf, -1.0]),
        (Range(0, several=True), [(), (1, 2.0), [0.5]], [1, (1, -1), (1, True), None, "12"]),
        (Range(2, below=3, optional=True), [None, 2, 2.9], [3, 1.9]),
    ],
)
def test_what_a_range_takes(allowed: Range, taken: list[object], refused: list[object]) -> None:
    assert all(map(allowed.takes, taken))
    assert not any(map(allowed.takes, refused))


def test_a_range_says_what_it_takes() -> None:
    assert str(COUNT) == "a whole number from 0"
    assert str(Range(0, 1, unit="m")) == "a number from 0 to 1 m"
    assert str(Range(high=2, above=0, optional=True)) == "a number over 0 up to 2, or none"

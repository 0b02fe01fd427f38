"""Settings changed from the command line by name."""

from __future__ import annotations

import pytest

from megrasp_core.cli.common import changed
from megrasp_core.errors import InvalidRequestError
from megrasp_core.network import PRESETS
from megrasp_core.training import TrainConfig


def test_values_take_the_type_of_their_field():
    network = changed(
        PRESETS["small"],
        ["width=96", "s_min=0.015", "scene_tokens=[52, 26, 17]", "radii=[1, 2, 3]"],
        "--network",
    )
    assert (network.width, network.s_min, network.scene_tokens) == (96, 0.015, (52, 26, 17))
    config = changed(
        TrainConfig(),
        ["low_levels=0.3", "nearest_copy=true", "learning_rate=1", "sampler.steps=12",
         "sampler.kind=deterministic", "train_only=heads", "model_id=mine"],
        "--set",
    )  # fmt: skip
    assert config.low_levels == 0.3 and config.nearest_copy is True
    assert isinstance(config.learning_rate, float)
    assert (config.sampler.steps, config.sampler.kind) == (12, "deterministic")
    assert config.sampler.restarts == TrainConfig().sampler.restarts
    assert (config.train_only, config.model_id) == ("heads", "mine")
    assert changed(config, ["low_levels=null"], "--set").low_levels is None
    assert TrainConfig.from_dict(config.to_dict()) == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("width", "--set width was given; expected NAME=VALUE"),
        ("wide=3", r"names no field of TrainConfig; expected one of network, model_id"),
        ("sampler.stride=3", r"names no field of SamplerSettings; expected one of kind, steps"),
        ("seed.x=3", "seed has no fields; expected its value"),
        ("seed=1.5", "expected a value like 1"),
        ("nearest_copy=3", "expected a value like False"),
        ("train_only=tails", "expected a value like 'all'"),
        ("seed=[", "expected a value like 1"),
        ("total_poses=0", "total_poses 0 was given; expected counts of at least 1"),
        ("sampler.steps=0", "got steps=0"),
    ],
)
def test_wrong_changes_say_what_is_right(change, message):
    with pytest.raises(InvalidRequestError, match=message):
        changed(TrainConfig(), [change], "--set")

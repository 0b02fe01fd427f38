"""Settings changed from the command line by name."""

from __future__ import annotations

import pytest

from megrasp_core.cli import main
from megrasp_core.cli.common import changed
from megrasp_core.errors import InvalidRequestError, ModelError
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
        ["low_levels=0.3", "nearest_copy=true", "learning_rate=1", "weight_decay=1e-4",
         "sampler.steps=12", "sampler.kind=deterministic", "train_only=heads", "model_id=mine"],
        "--set",
    )  # fmt: skip
    assert config.low_levels == 0.3 and config.nearest_copy is True
    assert isinstance(config.learning_rate, float) and config.weight_decay == 1e-4
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
        ("total_poses=0", "total_poses 0 was given; expected a whole number from 1"),
        ("learning_rate=fast", "expected a value like 0.001"),
        ("sampler.steps=0", "steps 0 was given"),
    ],
)
def test_wrong_changes_say_what_is_right(change, message):
    with pytest.raises(InvalidRequestError, match=message):
        changed(TrainConfig(), [change], "--set")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("width=95", "width 95 cannot be divided by heads 4"),
        ("blocks=[1, 1]", r"blocks \[1, 1\] has not 3 entries"),
        ("fine_irreps=16x0e+8x1o", "fine_irreps '16x0e\\+8x1o' is not of the form"),
    ],
)
def test_sizes_that_do_not_go_together_are_named(change, message):
    with pytest.raises(ModelError, match=message):
        changed(PRESETS["small"], [change], "--network")


def test_options_that_contradict_each_other_are_refused(tmp_path, capsys):
    begin = ["train", "--data", str(tmp_path), "--out", str(tmp_path / "run")]
    for more, message in (
        (["--resume", "--set", "seed=2"], "--set was given with --resume"),
        (["--heads-of", "megrasp-bin", "--network", "width=32"], "brings its network"),
        (["--start-from", "a", "--heads-of", "b"], "--start-from and --heads-of were given"),
        (["--set", "train_only=heads"], "expected the model whose heads are trained"),
        (["--device", "gpu"], "device 'gpu' cannot be used"),
        (["--processes", "3"], "expected at most one process a scene"),
    ):
        assert main([*begin, *more]) == 2
        assert message in capsys.readouterr().err


def test_a_share_of_scenes_is_a_share(tmp_path, capsys):
    for name in ("--bins", "--obstacles"):
        command = ["data", "scenes", "--out", str(tmp_path), "--library", str(tmp_path)]
        assert main([*command, name, "1.5"]) == 2
        assert f"{name} 1.5 was given; expected a share" in capsys.readouterr().err

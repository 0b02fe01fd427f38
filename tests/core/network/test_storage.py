"""Models on disk."""

from __future__ import annotations

import dataclasses
import json
import os

import pytest
import torch
from network_scenes import scene, tokens

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.errors import ModelError
from megrasp_core.lie import PoseBatch
from megrasp_core.network import (
    PRESETS,
    DefaultModels,
    GraspModel,
    default_model,
    load_model,
    save_model,
)
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.ranking import Calibration


@pytest.fixture
def folder(tmp_path):
    torch.manual_seed(0)
    return save_model(GraspModel(PRESETS["tiny"], model_id="tiny-test"), tmp_path / "tiny-test")


@torch.no_grad()
def test_round_trip_predicts_the_same(folder):
    torch.manual_seed(0)
    made, loaded = GraspModel(PRESETS["tiny"]).eval(), load_model(folder)
    assert loaded.model_id == "tiny-test"
    nodes, gripper = scene(), tokens(8)
    args = (PoseBatch(torch.eye(3)[None], torch.zeros(1, 3)), torch.ones(1))
    outs = [
        model.predict(model.encode_scene(nodes), model.encode_gripper(gripper), *args).residual
        for model in (made, loaded)
    ]
    # Weights mapped from a file lie elsewhere in memory, where products may round otherwise.
    assert torch.allclose(*outs, atol=1e-6)


def test_everybody_may_read_a_model(folder):
    modes = {path.name: path.stat().st_mode & 0o777 for path in folder.iterdir()}
    assert set(modes) == {"model.safetensors", "config.json"}, "nothing is left over"
    assert modes["model.safetensors"] == modes["config.json"]


def test_found_through_the_environment(folder, monkeypatch):
    monkeypatch.setenv("MEGRASP_MODELS", str(folder.parent))
    assert load_model("tiny-test").model_id == "tiny-test"


def test_unknown_model_lists_those_that_exist(folder, monkeypatch):
    monkeypatch.setenv("MEGRASP_MODELS", str(folder.parent))
    with pytest.raises(ModelError, match=r"'nothing' not found.*tiny-test") as error:
        load_model("nothing")
    assert error.value.code == 300


@pytest.mark.parametrize("damage", ["truncate", "flip", "foreign", "pipe"])
def test_damaged_weights_are_named(folder, damage):
    path = folder / "model.safetensors"
    content = path.read_bytes()
    if damage == "truncate":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flip":
        path.write_bytes(content[:-4] + b"abcd")
    elif damage == "pipe":
        path.unlink()
        os.mkfifo(path)
    else:
        save_model(GraspModel(PRESETS["small"]), folder.parent / "other")
        path.write_bytes((folder.parent / "other" / "model.safetensors").read_bytes())
    with pytest.raises(ModelError, match=r"model\.safetensors"):
        load_model(folder)


def test_config_with_an_unknown_field(folder):
    content = json.loads((folder / "config.json").read_text())
    content["network"]["colour"] = 1
    (folder / "config.json").write_text(json.dumps(content))
    with pytest.raises(ModelError, match=r"unknown fields \['colour'\]"):
        load_model(folder)


def test_the_facts_survive_a_round_trip(folder):
    model = load_model(folder)
    facts = dataclasses.replace(
        model.info,
        heads=("confidence",),
        sampler=SamplerSettings(steps=3),
        scene=SceneSettings(voxel=0.005),
        calibration=Calibration(bias=0.5),
        calibration_by_kind={"hand": Calibration(tilt=-1.0)},
        trained_grippers={"robotiq_2f85": "abc"},
        counters={"poses": 7},
        training={"seed": 1},
    )
    model.info = facts
    read = load_model(save_model(model, folder)).info
    assert read == dataclasses.replace(facts, sha256=read.sha256)
    assert read.parameters == sum(weight.numel() for weight in model.parameters())


def test_grippers_of_the_training_have_the_calibration_of_their_kind(folder):
    pooled, hands = Calibration(bias=0.5), Calibration(tilt=-1.0)
    info = dataclasses.replace(
        load_model(folder).info,
        calibration=pooled,
        calibration_by_kind={"hand": hands},
        trained_grippers={"shadow_hand": "abc", "robotiq_2f85": "def"},
    )
    assert info.calibration_for("shadow_hand", "hand") == hands
    assert info.calibration_for("robotiq_2f85", "adaptive") == pooled
    assert info.calibration_for("hand_of_a_stranger", "hand") == pooled


@pytest.mark.parametrize(
    ("entry", "value", "told"),
    [
        ("colour", 1, r"unknown entries \['colour'\]; expected some of \['calibration'"),
        ("heads", ["opinion"], r"heads are \['opinion'\].*'graspability'"),
        ("data_scenes", "many", r"data_scenes = 'many'; expected a whole number"),
        ("sampler", {"steps": "ten"}, r"'sampler' has steps = 'ten'; expected a whole number"),
        ("sampler", {"kind": "euler"}, r"'sampler' has kind = 'euler'.*ancestral"),
        ("sampler", {"steps": 0}, "expected a whole number from 1"),
        ("scene", {"voxels": 0.004}, r"'scene' has unknown entries \['voxels'\].*'voxel'"),
        ("scene", 4, "'scene' is 4; expected a mapping"),
        ("calibration", {"bias": "much"}, "bias = 'much'; expected a number"),
        (
            "calibration_by_kind",
            {"claw": {}},
            r"'claw'.*some of \['parallel', 'adaptive', 'hand'\]",
        ),
        (
            "calibration_by_kind",
            {"hand": {"slope": 1}},
            r"of hand' has unknown entries \['slope'\]",
        ),
    ],
)
def test_config_with_a_wrong_entry(folder, entry, value, told):
    content = json.loads((folder / "config.json").read_text())
    content[entry] = value
    (folder / "config.json").write_text(json.dumps(content))
    with pytest.raises(ModelError, match=told):
        load_model(folder)


@pytest.mark.parametrize(
    "content", ["[]", "{}", "{", '{"network": 3}', '{"network": {"width": "w"}}']
)
def test_config_of_another_kind(folder, content):
    (folder / "config.json").write_text(content)
    with pytest.raises(ModelError, match=r"config\.json cannot be read"):
        load_model(folder)


@pytest.mark.parametrize(
    ("kind", "gripper"),
    [(None, "robotiq_2f85"), ("parallel", "franka_hand"), ("hand", "allegro_hand")],
)
def test_the_default_models_say_what_they_were_trained_with(kind, gripper):
    models = DefaultModels()
    info = models.of(kind).info
    assert info.model_id == default_model(kind)
    assert models.of(kind) is models.of(kind)
    assert gripper in info.trained_grippers
    assert set(info.heads) == {"confidence", "graspability"}
    assert info.calibration is not None


def test_device_that_is_absent(folder):
    if torch.cuda.is_available():
        pytest.skip("this machine has the device that the test needs to be absent")
    with pytest.raises(ModelError, match="device 'cuda'"):
        load_model(folder, device="cuda")

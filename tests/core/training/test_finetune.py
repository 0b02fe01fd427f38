"""Few-shot fine-tuning with a tiny network: what is learnt, and that nothing else changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from megrasp_core.diffusion import NoiseSchedule
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import PoseBatch
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import SynthesisRequest
from megrasp_core.training import (
    FinetuneConfig,
    GivenGrasp,
    GivenScene,
    doubt,
    finetune,
    given_scene,
)

NEW, KNOWN = "robotiq_2f140", "robotiq_2f85"
CONFIG = FinetuneConfig(
    steps=60, check_every=20, folds=3, poses_per_scene=24, head_poses=4, node_sets=1,
    learning_rate=1e-2, keep_weight=1.0, validation_poses=96,
)  # fmt: skip
BOX = 0.05
"""Height of the box (m)."""


def grasp(seed: int, *, depth: float = 0.0, as_tcp: bool = False) -> GivenGrasp:
    """A box 4 cm wide on a floor, seen from above, taken from above with the TCP `depth` below
    its top.
    """
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-0.05, 0.05, 2)
    floor = rng.uniform((-0.15, -0.15, 0.0), (0.15, 0.15, 0.0005), (2500, 3))
    inside = (np.abs(floor[:, :2] - middle) < (0.02, 0.03)).all(1)
    top = rng.uniform((-0.02, -0.03, BOX - 0.0005), (0.02, 0.03, BOX), (900, 3))
    side = rng.uniform((-0.02, -0.03, 0.0), (-0.02, 0.03, BOX), (500, 3))
    other = side * (-1, 1, 1)
    box = np.concatenate([top, side, other]) + np.array([*middle, 0.0])
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[:3, 3] = (*middle, BOX - depth)
    pose = tcp if as_tcp else tcp @ np.linalg.inv(load_gripper(NEW).gripper_from_tcp)
    request = SynthesisRequest(sensor=(0.0, 0.0, 0.8), seed=0)
    pose = pose.astype(np.float64)
    return GivenGrasp(Cloud(np.concatenate([floor[~inside], box])), pose, request, f"{seed}.ply")


@pytest.fixture(scope="module")
def parent() -> GraspModel:
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="start")
    # Zeros as weights would hold the decoder's answer constant, whatever the gripper.
    for block in (*model.decoder.blocks, *model.confidence_decoder.blocks):
        torch.nn.init.normal_(block.film.weight, std=0.2)  # type: ignore[union-attr]
    model.info = dataclasses.replace(model.info, heads=("confidence", "graspability"))
    return model.eval().requires_grad_(False)


@pytest.fixture(scope="module")
def scenes(parent: GraspModel) -> list[GivenScene]:
    gripper = load_gripper(NEW)
    return [given_scene(grasp(seed, depth=0.02), gripper, parent.info.scene) for seed in range(6)]


@pytest.fixture(scope="module")
def result(parent, scenes):
    return finetune(parent, load_gripper(NEW), scenes, CONFIG)


def test_the_loss_of_grasps_left_out_falls(result):
    assert result.model is not None
    assert result.steps in (20, 40, 60) and result.gain > 2 * result.gain_error
    assert np.mean([*result.after.values()]) == pytest.approx(
        np.mean([*result.before.values()]) - result.gain
    )


def test_only_the_gripper_encoder_learns(parent, result):
    before, after = parent.state_dict(), result.model.state_dict()
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"gripper_encoder"}


def predictions(model: GraspModel, name: str, scene: GivenScene) -> torch.Tensor:
    """Of poses around the grasp, all that the decoder and the confidence say."""
    code = model.encode_gripper(load_gripper(name).tokens(model.config.gripper_tokens, seed=0))
    field = model.encode_scene(scene.seen.nodes)
    place = torch.from_numpy(scene.world_from_tcp[:3, 3] - scene.seen.nodes.centroid).float()
    offset = 0.02 * torch.randn(16, 3, generator=torch.Generator().manual_seed(3))
    rotation = torch.from_numpy(scene.world_from_tcp[:3, :3]).float().expand(16, 3, 3)
    poses = PoseBatch(rotation, place + offset)
    level = NoiseSchedule.of(model.config).random_levels(16, torch.Generator().manual_seed(4))
    found = model.predict(field, code, poses, level)
    return torch.cat(
        [found.residual, found.score, model.confidence(field, code, poses)[:, None]], 1
    )


def test_others_are_held_where_they_were(parent, scenes):
    """A known gripper, of the same kind at that, moves much less than without what holds it."""
    gripper = load_gripper(NEW)
    before = {name: predictions(parent, name, scenes[0]) for name in (NEW, KNOWN)}

    def moved(keep_weight: float) -> tuple[dict[str, float], float]:
        config = FinetuneConfig(**{**vars(CONFIG), "keep_weight": keep_weight})
        found = finetune(parent, gripper, scenes, config, steps=10)
        assert found.model is not None
        by_name = {
            name: float((predictions(found.model, name, scenes[0]) - said).square().mean().sqrt())
            for name, said in before.items()
        }
        return by_name, found.others

    (held, codes), (free, free_codes) = moved(100.0), moved(0.0)
    assert codes < 0.3 * free_codes
    assert held[KNOWN] < 0.3 * free[KNOWN]
    assert held[NEW] > 0


def test_a_seed_gives_one_model(parent, scenes, result):
    gripper = load_gripper(NEW)
    one, again = (finetune(parent, gripper, scenes[:2], CONFIG, steps=4) for _ in range(2))
    other = finetune(
        parent, gripper, scenes[:2], FinetuneConfig(**{**vars(CONFIG), "seed": 2}), steps=4
    )
    assert one.curve == () and np.isnan(one.gain)
    states = [found.model.state_dict() for found in (one, again, other) if found.model is not None]
    assert len(states) == 3
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert any(not torch.equal(states[0][name], states[2][name]) for name in states[0])


def test_nothing_gained_is_no_model(parent, scenes):
    """A rate of next to nothing gains nothing that differs from chance."""
    config = FinetuneConfig(**{**vars(CONFIG), "learning_rate": 1e-12, "steps": 2})
    found = finetune(parent, load_gripper(NEW), scenes, config)
    assert found.model is None and found.curve


def test_too_few_grasps_need_a_number_of_steps(parent, scenes):
    with pytest.raises(InvalidRequestError, match="2 grasps were given; expected at least 3"):
        finetune(parent, load_gripper(NEW), scenes[:2], CONFIG)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("millimetres", "in millimetres"),
        ("tcp", "as world_from_tcp"),
    ],
)
def test_far_grasps_are_told_with_the_frame_in_which_they_are_not(parent, change, words):
    given = grasp(1, as_tcp=change == "tcp")
    if change == "millimetres":
        given.world_from_gripper[:3, 3] *= 1000
    with pytest.raises(DataError, match="1.ply: the TCP of the grasp is .*" + words):
        given_scene(given, load_gripper(NEW), parent.info.scene)


def test_tcp_poses_are_asked_about(parent):
    gripper, settings = load_gripper(NEW), parent.info.scene
    given = [given_scene(grasp(seed, depth=0.01), gripper, settings) for seed in range(3)]
    assert doubt(given, gripper) is None

    def mistaken(scene: GivenScene) -> GivenScene:
        told = dataclasses.replace(scene.grasp, world_from_gripper=scene.world_from_tcp)
        return GivenScene(told, scene.seen, scene.world_from_tcp @ gripper.gripper_from_tcp)

    question = doubt([mistaken(scene) for scene in given], gripper)
    assert question is not None
    assert question.startswith("3 of 3 grasps collide") and "Is this world_from_tcp?" in question
    upside_down = [
        dataclasses.replace(scene, world_from_tcp=scene.world_from_tcp @ np.diag([1, -1, -1, 1]))
        for scene in given[:2]
    ]
    question = doubt([*upside_down, given[2]], gripper)
    assert question is not None and question.startswith("2 of 3 grasps collide")

"""What a step draws, what is held out, and the losses' own arithmetic."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from training_scenes import GRIPPER, HELD, record, written

from megrasp_core.diffusion import NoiseSchedule
from megrasp_core.errors import DataError
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import so3
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.training import (
    SceneSource,
    TrainConfig,
    TrainingEntry,
    balance,
    divided,
    is_held_out,
    read_entries,
    scene_batch,
    scene_keys,
    scene_losses,
    validation_pairs,
    without_objects,
)
from megrasp_core.training.batching import gripper_shares, varied
from megrasp_core.training.losses import graspability_loss, nearest_copies

HAND, PROCEDURAL = "allegro_hand", "angular_000062"
CONFIG = TrainConfig(
    network=PRESETS["tiny"],
    grippers=(GRIPPER, HAND),
    poses_per_scene=30,
    confidence_poses=8,
    node_sets=2,
    validation_pairs=2,
)


@pytest.fixture(scope="module")
def entries(tmp_path_factory):
    """Scenes of one to three grippers, objects o1 to o3, of which o3 is held out."""
    racks = [(GRIPPER,), (GRIPPER, HAND), (GRIPPER, PROCEDURAL), (HAND,)]
    scenes = [
        record(seed, grippers=racks[seed % 4], objects=("o1", "o2", "o3")) for seed in range(12)
    ]
    folder = written(tmp_path_factory.mktemp("scenes"), scenes)
    return list(read_entries([folder]).values())


def source(entries, config=CONFIG, hands=frozenset()):
    return SceneSource(entries, config, SceneSettings(), hands)


def test_held_out_objects_validate_and_never_train(entries):
    assert [is_held_out(name) for name in ("o1", "o2", "o3")] == [False, False, True]
    division = divided(entries)
    assert len(division.train) == len(division.validation) == len(entries)
    for part, owners in ((division.train, {0, 1}), (division.validation, {2})):
        for entry in part:
            for table in entry.tables.values():
                assert set(table.owner.tolist()) <= owners
    total = sum(len(table) for entry in entries for table in entry.tables.values())
    assert total == sum(
        len(table)
        for part in (division.train, division.validation)
        for entry in part
        for table in entry.tables.values()
    )


def test_every_gripper_validates(entries):
    pairs = validation_pairs(divided(entries).validation, CONFIG)
    assert {gripper for _, gripper in pairs} == {GRIPPER, HAND, PROCEDURAL}
    counts = [sum(gripper == name for _, gripper in pairs) for name in (GRIPPER, HAND)]
    assert counts == [2, 2]
    assert pairs == validation_pairs(list(reversed(divided(entries).validation)), CONFIG)


def test_validation_scenes_must_hold_other_objects(entries, tmp_path):
    other = [record(seed, objects=("p1", "p2")) for seed in range(3)]
    held = list(read_entries([written(tmp_path / "other", other)]).values())
    assert len(without_objects(entries, held).train) == len(entries)
    shared = [record(seed, objects=("o2", "p2")) for seed in range(3)]
    held = list(read_entries([written(tmp_path / "shared", shared)]).values())
    with pytest.raises(DataError, match="1 objects, o2 for one, have labels in the training"):
        without_objects(entries, held)


def test_entries_of_two_data_sets_with_the_same_scenes_stay_apart(tmp_path):
    folders = [written(tmp_path / name, [record(1), record(2)]) for name in ("a", "b")]
    first = read_entries(folders)
    assert len(first) == 4
    assert set(first) == set(scene_keys(folders)) == {entry.key for entry in first.values()}
    assert all(entry is first[key] for key, entry in read_entries(folders, first).items())


def test_a_batch_holds_what_was_asked_for(entries):
    drawn = [source(entries).draw(np.random.default_rng(seed)) for seed in range(12)]
    for batch in drawn:
        counts = [len(poses) for poses in batch.positives.values()]
        assert sum(counts) == batch.noisy_poses == 30
        assert max(counts) - min(counts) <= 1
        assert batch.labelled_poses <= 8
        for name in batch.positives:
            assert len(batch.graspable[name]) == HELD
    assert {name for batch in drawn for name in batch.positives} == {GRIPPER, HAND, PROCEDURAL}
    assert not source(entries).draw(np.random.default_rng(0), confidence=False).labelled


def test_draws_depend_on_the_generator_alone(entries):
    one, two = (source(entries).draw(np.random.default_rng([1, 5, 0])) for _ in range(2))
    assert np.array_equal(one.nodes.points, two.nodes.points)
    for name, poses in one.positives.items():
        assert torch.equal(poses.poses.rotation, two.positives[name].poses.rotation)


def test_grippers_get_their_shares():
    names = [GRIPPER, HAND, PROCEDURAL, "angular_000063"]
    config = dataclasses.replace(CONFIG, procedural_share=0.25, hand_weight=1.5)
    shares = gripper_shares(names, config, frozenset({HAND}))
    assert shares == pytest.approx([0.3, 0.45, 0.125, 0.125])
    assert gripper_shares(names[2:], config) == pytest.approx([0.5, 0.5])
    assert gripper_shares(names[:2], config) == pytest.approx([0.5, 0.5])


def test_batch_is_centred_like_its_nodes(entries):
    entry = entries[0]
    nodes, graph = entry.nodes(SceneSettings(), CONFIG.network)
    batch = scene_batch(nodes, graph, entry.tables, CONFIG, np.random.default_rng(0))
    stored = entry.tables[GRIPPER].translation
    drawn = batch.positives[GRIPPER].poses.translation.numpy() + batch.nodes.centroid
    gap = np.linalg.norm(drawn[:, None] - stored[None], axis=-1).min(1)
    assert gap.max() < 1e-6


def test_node_sets_differ_and_are_kept(entries):
    entry = entries[0]
    (one, graph), (two, _), (again, kept) = (
        entry.nodes(SceneSettings(max_nodes=100), CONFIG.network, which) for which in (5, 6, 5)
    )
    assert len(one.points) == 100 and not np.array_equal(one.points, two.points)
    assert np.array_equal(one.points, again.points)
    for first, second in zip(graph.same, kept.same, strict=True):
        assert torch.equal(first, second) and first.dtype == torch.long


def test_networks_with_other_graphs_do_not_share_them(entries):
    fine = dataclasses.replace(PRESETS["tiny"], fine_neighbours=12, neighbours=5)
    found = [entries[0].nodes(SceneSettings(), network)[1] for network in (PRESETS["tiny"], fine)]
    count = len(found[0].nodes[0])
    assert [graph.fine.shape for graph in found] == [(count, 0), (count, 12)]
    assert [graph.same[0].shape[1] for graph in found] == [PRESETS["tiny"].neighbours, 5]


def test_nodes_can_forget_gravity_and_tremble(entries):
    nodes, _ = entries[0].nodes(SceneSettings(), CONFIG.network)
    rng = np.random.default_rng(0)
    still = varied(nodes, rng, jitter=0.0, drop_gravity=True)
    assert not still.gravity.any() and nodes.gravity[2] == -1
    moved = varied(nodes, rng, jitter=0.001, drop_gravity=False)
    for before, after in ((nodes, moved), (nodes.surface, moved.surface)):
        assert 0.0008 < np.std(after.points - before.points) < 0.0012
    assert moved.gravity[2] == -1


def test_balanced_batches_give_rare_objects_their_share():
    owner = np.array([0] * 90 + [1] * 10)
    weights = balance(owner)
    assert np.isclose(weights[owner == 1].sum(), 0.5)
    assert np.isclose(weights.sum(), 1.0)
    weights = balance(owner, np.array([1.0, 3.0]))
    assert np.isclose(weights[owner == 1].sum(), 0.75)
    assert np.isclose(weights.sum(), 1.0)


@pytest.mark.parametrize(("rare", "share"), [(0.0, 0.1), (0.5, 0.25), (1.0, 0.5)])
def test_objects_of_few_scenes_get_more_of_the_draws(rare, share):
    names = [("common",)] * 9 + [("rare",)]
    scenes = [TrainingEntry(record(seed, objects=name)) for seed, name in enumerate(names)]
    config = dataclasses.replace(CONFIG, rare_objects=rare, node_sets=1, point_jitter=0.0)
    drawn = source(scenes, config)
    places = [entry.nodes(SceneSettings(), config.network, 1)[0].centroid for entry in scenes]
    rng = np.random.default_rng(0)
    found = [drawn.draw(rng, confidence=False).nodes.centroid for _ in range(400)]
    assert np.isclose(np.mean([np.allclose(one, places[9]) for one in found]), share, atol=0.07)


def test_the_nearest_copy_against_all_copies():
    turns = Rotation.random(60, random_state=1).as_matrix()
    noisy = torch.as_tensor(Rotation.random(60, random_state=2).as_matrix())
    rotation = torch.as_tensor(turns)
    fold = torch.tensor([1, 2, 3] * 20)
    got = nearest_copies(rotation, noisy, fold)
    for place, n in enumerate(fold.tolist()):
        spin = Rotation.from_rotvec([[0, 0, 2 * np.pi * k / n] for k in range(n)]).as_matrix()
        copies = rotation[place] @ torch.as_tensor(spin)
        angles = so3.log(noisy[place].T @ copies).norm(dim=-1)
        assert torch.allclose(got[place], copies[int(angles.argmin())], atol=1e-6)
    assert torch.allclose(got[fold == 1], rotation[fold == 1], atol=1e-6)


def test_objects_that_nobody_tried_say_nothing_of_graspability(entries):
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"])
    entry = entries[0]
    nodes, graph = entry.nodes(SceneSettings(), CONFIG.network)
    gripper = load_gripper(GRIPPER).tokens(PRESETS["tiny"].gripper_tokens)
    field, code = model.encode_scene(nodes, graph), model.encode_gripper(gripper)
    corner = field.points[1][field.points[1].sum(1).argmin()][None].detach()
    nobody = torch.zeros(0, 3)

    def gradient(graspable: torch.Tensor, tried: torch.Tensor) -> torch.Tensor:
        field.invariants.retain_grad()
        field.invariants.grad = None
        loss = graspability_loss(model, field, code, graspable, tried, CONFIG)
        if loss.requires_grad:
            loss.backward(retain_graph=True)
        value = field.invariants.grad
        return torch.zeros_like(field.invariants) if value is None else value.abs().sum(1)

    assert not gradient(nobody, nobody).any()
    near = torch.cdist(field.points[1], corner).squeeze(1) < CONFIG.tried_radius
    assert 0 < int(near.sum()) < len(near)
    touched = gradient(corner, corner) > 0
    assert torch.equal(touched, near)


def test_losses_are_finite_and_of_every_kind(entries):
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"])
    schedule = NoiseSchedule()
    config = dataclasses.replace(CONFIG, nearest_copy=True, poses_per_scene=200)
    batch = source(entries, config).draw(np.random.default_rng(1))
    assert GRIPPER in batch.positives
    codes = {
        name: model.encode_gripper(load_gripper(name).tokens(PRESETS["tiny"].gripper_tokens))
        for name in batch.grippers
    }
    found = [
        scene_losses(
            model, codes, batch, chosen, schedule, torch.Generator().manual_seed(3), {GRIPPER: 2}
        )
        for chosen in (CONFIG, config)
    ]
    for losses in found:
        assert set(losses.values) == {"diffusion", "score", "confidence", "graspability"}
        assert all(np.isfinite(value) for value in losses.values.values())
        assert len(losses.level) == len(losses.residual) == 200
        assert sum(count for _, count in losses.owners) == 200
        assert losses.values["diffusion"] == pytest.approx(float(losses.residual.mean()), rel=1e-5)
    assert found[1].values["diffusion"] != found[0].values["diffusion"]

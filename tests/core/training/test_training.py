"""A tiny run from data on disk to a model that loads, stopped and resumed."""

from __future__ import annotations

import dataclasses
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from training_scenes import GRIPPER, record, written

from megrasp_core.cli import main
from megrasp_core.drawing.training_curves import append_losses, read_losses
from megrasp_core.errors import DataError, InvalidRequestError, TrainingError
from megrasp_core.network import PRESETS, GraspModel, load_model
from megrasp_core.training import (
    Counters,
    Team,
    TrainConfig,
    TrainingJob,
    TrainingRun,
    rate_factor,
    resume_training,
    train,
)

CONFIG = TrainConfig(
    network=PRESETS["tiny"],
    model_id="tiny-run",
    grippers=(GRIPPER,),
    scenes_per_step=1,
    poses_per_scene=32,
    confidence_poses=8,
    confidence_every=1,
    warmup_steps=2,
    total_poses=32 * 6,
    node_sets=2,
    validation_pairs=1,
)
# By the hash of their names "o3" is held out, the others are not.
OBJECTS = ("o1", "o2", "o3")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return written(
        tmp_path_factory.mktemp("data"), (record(seed, objects=OBJECTS) for seed in range(10))
    )


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_model(folder / "model").state_dict()


def distance(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> float:
    return float(sum((one[k] - other[k]).abs().sum() for k in one))


def part_of(job: TrainingJob, config: TrainConfig, poses: int) -> None:
    """Begin the whole plan, leave after so many poses."""
    run = TrainingRun(job, config)
    while run.counters.poses < poses:
        run.step()
    run.save()


@pytest.mark.slow
def test_run_resume_and_load(data, tmp_path):
    seen: list[dict[str, float]] = []
    job = TrainingJob((data,), tmp_path)
    part_of(job, CONFIG, 32 * 3)
    first = load_model(tmp_path / "model")
    resume_training(job, on_progress=lambda run, losses: seen.append(losses))
    assert len(seen) == 3
    assert {"diffusion", "score", "confidence", "graspability"} <= set(seen[0])
    second = load_model(tmp_path / "model")
    counters = second.info.counters
    assert counters["poses"] == 32 * 6
    assert counters["scenes"] == counters["steps"] == 6
    assert not torch.equal(first.residual_head[0].weight, second.residual_head[0].weight), (
        "a resumed run must go on training"
    )
    assert list(second.info.trained_grippers) == [GRIPPER]
    lines = [json.loads(line) for line in (tmp_path / "losses.jsonl").read_text().splitlines()]
    assert [line["steps"] for line in lines] == [3, 6]
    for line in lines:
        assert np.isfinite(line["validation_diffusion"])
        assert list(line["per_gripper"]) == [GRIPPER]
        assert set(line["per_band"]) == {"low", "middle", "high"}
    assert (tmp_path / "losses.png").stat().st_size > 1000


@pytest.mark.slow
def test_resume_goes_on_as_if_never_stopped(data, tmp_path):
    """Up to the rounding of what the checkpoint keeps of the optimiser."""
    config = dataclasses.replace(CONFIG, total_poses=32 * 24)
    whole = TrainingJob((data,), tmp_path / "whole")
    train(whole, config)
    part_of(TrainingJob((data,), tmp_path / "half"), config, 32 * 12)
    shutil.copytree(tmp_path / "half", tmp_path / "split")
    resume_training(TrainingJob((data,), tmp_path / "split"))
    ends, split, half = (weights(tmp_path / name) for name in ("whole", "split", "half"))
    assert distance(ends, split) < 0.1 * distance(ends, half)
    losses = [
        json.loads((tmp_path / name / "losses.jsonl").read_text().splitlines()[-1])
        for name in ("whole", "split")
    ]
    assert losses[1]["validation_diffusion"] == pytest.approx(
        losses[0]["validation_diffusion"], rel=0.02
    )
    assert losses[0]["poses"] == losses[1]["poses"]


def test_everything_but_the_place_comes_from_the_checkpoint(data, tmp_path):
    """A run for two grippers with its own settings goes on as it was, whatever is default."""
    config = dataclasses.replace(
        CONFIG,
        grippers=(GRIPPER, "franka_hand"),
        network=dataclasses.replace(PRESETS["tiny"], s_min=0.02, gripper_tokens=6),
        model_id="mine",
        learning_rate=2e-3,
    )
    job = TrainingJob((data,), tmp_path)
    part_of(job, config, 32)
    model = resume_training(job, total_poses=32 * 3)
    info = load_model(tmp_path / "model").info
    assert model.config == config.network
    assert info.model_id == "mine"
    assert list(info.trained_grippers) == [GRIPPER, "franka_hand"]
    assert info.training["learning_rate"] == 2e-3
    assert info.counters["poses"] == info.training["total_poses"] == 32 * 3


def test_a_run_starts_from_the_weights_of_a_model(data, tmp_path):
    """All of it goes on learning: network, name and sampler are the model's, the rate is given."""
    part_of(TrainingJob((data,), tmp_path / "first"), CONFIG, 32)
    first = load_model(tmp_path / "first" / "model")
    code = main(
        ["train", "--start-from", str(tmp_path / "first" / "model"), "--data", str(data),
         "--out", str(tmp_path / "second"), "--gripper", GRIPPER, "--total-poses", "64",
         "--set", "learning_rate=1e-6", "poses_per_scene=32", "scenes_per_step=1"]
    )  # fmt: skip
    assert code == 0
    second = load_model(tmp_path / "second" / "model")
    assert second.config == first.config
    assert second.info.model_id == "tiny-run"
    assert second.info.counters["poses"] == 64
    fresh = GraspModel(first.config).state_dict()
    kept, before = second.state_dict(), first.state_dict()
    assert 0 < distance(kept, before) < 1e-3 * distance(fresh, before)


def test_a_checkpoint_is_seven_bytes_a_parameter(data, tmp_path):
    part_of(TrainingJob((data,), tmp_path), CONFIG, 32)
    parameters = sum(value.numel() for value in weights(tmp_path).values())
    size = (tmp_path / "checkpoint.safetensors").stat().st_size
    names = size - 7 * parameters
    assert 0 < names < 300_000, "what is not of the parameters is their names and the config"


def test_the_rate_follows_what_was_seen():
    config = dataclasses.replace(CONFIG, total_poses=1000, warmup_steps=10, constant_share=0.4)
    late = {"steps": 50}
    factors = [
        rate_factor(Counters(steps=4), config),
        rate_factor(Counters(poses=300, **late), config),
        rate_factor(Counters(poses=700, **late), config),
        rate_factor(Counters(poses=1000, **late), config),
    ]
    assert factors == pytest.approx([0.5, 1.0, 0.5, 0.0])
    busy = Counters(poses=300, seconds=1e6, **late)
    assert rate_factor(busy, config) == factors[1], "a busy machine trains the same model"
    short = dataclasses.replace(config, warmup_steps=500)
    rising = [rate_factor(Counters(steps=4, poses=poses), short) for poses in (0, 25, 50)]
    assert rising == pytest.approx([0.01, 0.5, 1.0]), "a short plan is not warmed up for long"


@pytest.mark.slow
def test_a_stretch_ends_in_time_and_goes_on(data, tmp_path):
    config = dataclasses.replace(CONFIG, total_poses=10**9)
    job = TrainingJob((data,), tmp_path, seconds=0.5)
    train(job, config)
    before = load_model(tmp_path / "model").info.counters
    resume_training(job)
    after = load_model(tmp_path / "model").info.counters
    assert 0 < before["poses"] < after["poses"] < 10**8
    assert (before["stretches"], after["stretches"]) == (1, 2)


@pytest.mark.slow
def test_sigterm_saves_and_exits_0(data, tmp_path):
    program = "from megrasp_core.cli import main; raise SystemExit(main())"
    command = [
        sys.executable, "-c", program, "train", "--data", str(data), "--out", str(tmp_path),
        "--preset", "tiny", "--gripper", GRIPPER, "--total-poses", "1000000000",
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert "10 scenes" in process.stdout.readline(), "it says when it has begun"
        os.kill(process.pid, signal.SIGTERM)
        output, _ = process.communicate(timeout=120.0)
    finally:
        process.kill()
    assert process.returncode == 0, output
    assert "--resume goes on from there" in output
    assert load_model(tmp_path / "model").info.counters["steps"] >= 1
    assert (tmp_path / "checkpoint.safetensors").exists()


@pytest.mark.slow
def test_two_processes_train_what_one_does(data, tmp_path):
    """The same scenes a step, shared by two: sums of gradients differ by rounding alone."""
    config = dataclasses.replace(
        CONFIG, scenes_per_step=2, total_poses=64 * 4, confidence_every=2, warmup_steps=1
    )
    for processes in (1, 2):
        job = TrainingJob((data,), tmp_path / str(processes), processes=processes)
        train(job, config)
    one, two = (weights(tmp_path / name) for name in ("1", "2"))
    torch.manual_seed(config.seed)
    start = TrainingRun(TrainingJob((data,), tmp_path / "0"), config).model.state_dict()
    assert distance(one, two) < 0.01 * distance(one, start)
    counters = [load_model(tmp_path / name / "model").info.counters for name in ("1", "2")]
    for name in ("steps", "poses", "labelled_poses", "scenes"):
        assert counters[0][name] == counters[1][name]


@pytest.mark.slow
def test_processes_of_torchrun_train_what_one_process_does(data, tmp_path):
    """The same command under torchrun, whose two processes take a scene of a step each."""
    command = [
        "-m", "megrasp_core", "train", "--data", str(data), "--preset", "tiny",
        "--gripper", GRIPPER, "--total-poses", str(64 * 4), "--set", "scenes_per_step=2",
        "poses_per_scene=32", "confidence_poses=8", "node_sets=2", "validation_pairs=1",
        "warmup_steps=1",
    ]  # fmt: skip
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    outputs = []
    for name, before in (("1", []), ("2", torchrun)):
        done = subprocess.run(
            [sys.executable, *before, *command, "--out", str(tmp_path / name)],
            capture_output=True, text=True, timeout=300.0, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout)
    assert outputs[1].count("wrote checkpoint and model") == 1, "one of them writes and tells"
    one, two = (weights(tmp_path / name) for name in ("1", "2"))
    torch.manual_seed(1)
    start = GraspModel(PRESETS["tiny"]).state_dict()
    assert distance(one, two) < 0.01 * distance(one, start)
    counters = [load_model(tmp_path / name / "model").info.counters for name in ("1", "2")]
    for name in ("steps", "poses", "labelled_poses", "scenes"):
        assert counters[0][name] == counters[1][name]


def test_what_a_launcher_says_is_obeyed_or_refused(tmp_path):
    where = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": "29500"}
    assert Team.launched({**where, "RANK": "3", "WORLD_SIZE": "8"}) == Team(3, 8)
    assert Team.launched({**where, "RANK": "0", "WORLD_SIZE": "1"}) is None
    assert Team.launched({"RANK": "0", "WORLD_SIZE": "2"}) is None, "nobody says where to meet"
    for rank, size in (("2", "2"), ("-1", "2"), ("a", "2"), ("0", "0")):
        with pytest.raises(InvalidRequestError, match=f"RANK {rank} and WORLD_SIZE {size}"):
            Team.launched({**where, "RANK": rank, "WORLD_SIZE": size})
    with pytest.raises(InvalidRequestError, match="Leave --processes out"):
        TrainingJob((tmp_path,), tmp_path, processes=2, place=Team(0, 2))
    with pytest.raises(InvalidRequestError, match="4 processes were asked for and a step has 1"):
        train(TrainingJob((tmp_path,), tmp_path, place=Team(0, 4)), CONFIG)


def test_a_step_is_shared_out_whole():
    slots = [list(Team(rank, 3).slots(7)) for rank in range(3)]
    assert sorted(slot for part in slots for slot in part) == list(range(7))


@pytest.mark.slow
def test_training_learns_a_fixed_grasp(tmp_path):
    """One top-down grasp in every scene: well below the loss of predicting zero (about 1)."""
    scenes = [record(seed) for seed in range(4)]
    for scene in scenes:
        scene.labels[GRIPPER].world_from_tcp[:] = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]
    written(tmp_path / "data", scenes)
    losses = []
    config = dataclasses.replace(CONFIG, total_poses=32 * 100, learning_rate=3e-3)
    train(
        TrainingJob((tmp_path / "data",), tmp_path / "run"),
        config,
        on_progress=lambda run, values: losses.append(values["diffusion"]),
    )
    assert np.mean(losses[:5]) > 0.9
    assert np.mean(losses[-30:]) < 0.8


def test_heads_only_leaves_the_diffusion(data, tmp_path):
    base = train(
        TrainingJob((data,), tmp_path / "base"), dataclasses.replace(CONFIG, total_poses=32)
    )
    config = dataclasses.replace(
        CONFIG, train_only="heads", total_poses=40, confidence_weight=1.0, graspability_weight=0.0
    )
    after = train(TrainingJob((data,), tmp_path / "heads"), config, start_from=base)
    before = base.state_dict()
    for name, value in after.state_dict().items():
        same = torch.equal(value, before[name])
        if name.startswith("confidence_head"):
            assert not same, f"{name} must have been trained"
        if not name.startswith(("confidence", "graspability")):
            assert same, f"{name} must not change"
    info = load_model(tmp_path / "heads" / "model").info
    assert info.counters["poses"] == 0 and info.counters["labelled_poses"] >= 40
    assert info.started_from["model_id"] == "tiny-run"


def test_growing_data_comes_in_at_a_checkpoint(data, tmp_path):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    run = TrainingRun(TrainingJob((folder,), tmp_path / "run"), CONFIG)
    run.read()
    pairs, entries = run.pairs, list(run.source.entries)
    written(folder, [record(seed, objects=OBJECTS) for seed in range(20, 23)])
    run.read()
    assert len(run.source.entries) == len(entries) + 3
    assert run.pairs == pairs, "what validates stays"
    names = {entry.name: entry for entry in run.source.entries}
    for before in entries:
        assert names[before.name]._sets is before._sets, "what was made of a scene is kept"


def test_what_cannot_be_read_again_does_not_end_a_run(data, tmp_path, caplog):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    run = TrainingRun(TrainingJob((folder,), tmp_path / "run"), CONFIG)
    run.read()
    entries = len(run.source.entries)
    (folder / "scenes" / "scene_0000000099.npz").write_bytes(b"no scene")
    run.read_again()
    assert len(run.source.entries) == entries
    assert "what came to the data is left out" in caplog.text


def test_a_line_that_a_kill_cut_off_is_passed_over(tmp_path):
    file = tmp_path / "losses.jsonl"
    append_losses(file, {"steps": 1})
    with file.open("a") as half:
        half.write('{"steps": 2, "tra')
    append_losses(file, {"steps": 3})
    assert [line["steps"] for line in read_losses(file)] == [1, 3]


def test_a_run_goes_on_with_what_validated_before(data, tmp_path):
    job = TrainingJob((data,), tmp_path / "run")
    part_of(job, CONFIG, 32)
    other = written(tmp_path / "other", [record(seed, objects=("p1", "p2")) for seed in range(3)])
    with pytest.raises(DataError, match=r"begun without scenes of its own .* is resumed with"):
        resume_training(dataclasses.replace(job, validation=(other,)))
    with pytest.raises(DataError, match="none of the 1 pairs of scene and gripper"):
        resume_training(dataclasses.replace(job, data=(other,)))
    own = TrainingJob((data,), tmp_path / "own", validation=(other,))
    part_of(own, CONFIG, 32)
    with pytest.raises(DataError, match=r"begun with scenes of its own .* is resumed without"):
        resume_training(dataclasses.replace(own, validation=()))


@pytest.mark.slow
def test_steps_without_a_finite_gradient_change_nothing_and_end_the_run(data, tmp_path):
    run = TrainingRun(TrainingJob((data,), tmp_path), CONFIG)
    run.step()
    before = {k: v.clone() for k, v in run.model.state_dict().items()}
    poses = run.counters.poses
    handle = run.model.residual_head.register_forward_hook(lambda _, __, out: out * float("nan"))
    run.step()
    assert all(torch.equal(v, before[k]) for k, v in run.model.state_dict().items())
    assert (run.counters.poses, run.counters.skipped, run.counters.steps) == (poses, 1, 2)
    assert all(np.isfinite(value) for value in run.averages.values())
    with pytest.raises(TrainingError, match="no finite number for 50 steps"):
        while run.counters.steps < 60:
            run.step()
    assert run.counters.steps == 51
    handle.remove()


@pytest.mark.slow
def test_a_lost_process_leaves_what_was_trained(data, tmp_path):
    config = dataclasses.replace(CONFIG, scenes_per_step=2, total_poses=10**9)
    job = TrainingJob((data,), tmp_path, processes=2)

    def kill(run: TrainingRun, _: dict[str, float]) -> None:
        if run.counters.steps == 3:
            for child in multiprocessing.active_children():
                child.kill()

    with pytest.raises(TrainingError, match="a process that shares the training ended"):
        train(job, config, on_progress=kill)
    assert load_model(tmp_path / "model").info.counters["steps"] == 3


def test_errors_say_what_to_do(data, tmp_path):
    with pytest.raises(InvalidRequestError, match=r"total_poses 0 was given; expected"):
        TrainConfig(total_poses=0)
    with pytest.raises(InvalidRequestError, match="several only on cpu"):
        TrainingJob((data,), tmp_path, device="cuda", processes=2)
    with pytest.raises(DataError, match="cannot be resumed"):
        resume_training(TrainingJob((data,), tmp_path))
    with pytest.raises(DataError, match="written by another version"):
        TrainConfig.from_dict({**CONFIG.to_dict(), "minutes": 3})
    empty = written(tmp_path / "empty", [])
    with pytest.raises(DataError, match="expected at least 2"):
        train(TrainingJob((empty,), tmp_path / "out"), CONFIG)
    with pytest.raises(DataError, match="no grasp of the grippers franka_hand"):
        config = dataclasses.replace(CONFIG, grippers=("franka_hand",))
        train(TrainingJob((data,), tmp_path / "out"), config)

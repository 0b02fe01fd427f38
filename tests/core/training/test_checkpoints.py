"""Checkpoints of other versions, and what ends a run of several processes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import torch.distributed as dist
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from megrasp_core.errors import DataError, TrainingError
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.training import Counters, TrainConfig, start
from megrasp_core.training.checkpoint import (
    TENSORS,
    CheckpointState,
    load_checkpoint,
    read_state,
    save_checkpoint,
)
from megrasp_core.training.processes import Team

CONFIG = TrainConfig(network=PRESETS["tiny"], grippers=("franka_hand",))


@pytest.fixture
def model() -> GraspModel:
    torch.manual_seed(0)
    return GraspModel(CONFIG.network)


def saved(folder: Path, model: GraspModel) -> torch.optim.AdamW:
    optimiser = torch.optim.AdamW(model.parameters())
    save_checkpoint(
        folder, model, dict(model.state_dict()), optimiser, CheckpointState(CONFIG, Counters())
    )
    return optimiser


@pytest.mark.parametrize(
    ("part", "entries"),
    [
        ("counters", {"steps": 1, "moons": 2}),
        ("counters", None),
        ("validation", [["one"]]),
        ("validation", None),
        ("facts", ...),
        ("config", {}),
        ("config", {**CONFIG.to_dict(), "scenes_per_step": "two"}),
        ("config", {**CONFIG.to_dict(), "scenes_per_step": 0}),
        ("config", {**CONFIG.to_dict(), "network": {"width": 7}}),
        ("config", {**CONFIG.to_dict(), "sampler": {"dance": 1}}),
    ],
)
def test_a_checkpoint_of_another_version_is_told(
    tmp_path: Path, model: GraspModel, part: str, entries: object
) -> None:
    optimiser = saved(tmp_path, model)
    assert read_state(tmp_path).config == CONFIG
    with safe_open(tmp_path / TENSORS, framework="pt") as file:
        content = json.loads(file.metadata()["content"])
    if entries is ...:
        del content[part]
    else:
        content[part] = entries
    tensors = load_file(tmp_path / TENSORS)
    save_file(tensors, tmp_path / TENSORS, {"content": json.dumps(content)})
    with pytest.raises(DataError, match="cannot be resumed"):
        read_state(tmp_path)
    with pytest.raises(DataError, match="cannot be resumed"):
        load_checkpoint(tmp_path, model, dict(model.state_dict()), optimiser)


@dataclasses.dataclass
class Run:
    """A run whose steps fail."""

    failure: object
    team: Team = dataclasses.field(default_factory=lambda: Team(0, 2))
    saves: int = 0

    def go_on(self, *_: object) -> None:
        if isinstance(self.failure, Exception):
            raise self.failure
        self.team.add_up([], torch.zeros(1, dtype=torch.float64))

    def save(self) -> None:
        self.saves += 1


def test_a_fault_of_this_process_is_not_laid_on_another_one() -> None:
    run = Run(RuntimeError("out of memory"))
    with pytest.raises(RuntimeError, match=r"^out of memory$"):
        start._go_on(run, lambda: False, None)  # type: ignore[arg-type]
    assert run.saves == 0


def test_a_lost_process_is_told_and_the_run_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise RuntimeError("Connection closed by peer\nmore")

    monkeypatch.setattr(dist, "all_reduce", lost)
    run = Run(SimpleNamespace())
    with pytest.raises(TrainingError, match=r"ended \(Connection closed by peer\).*saved"):
        start._go_on(run, lambda: False, None)  # type: ignore[arg-type]
    assert run.saves == 1

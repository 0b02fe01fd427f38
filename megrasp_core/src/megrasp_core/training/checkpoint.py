"""Checkpoints that resume, on this or another device: safetensors and JSON, no pickle.

Small enough to be committed, seven bytes a parameter: beside the weights (float32) eight bits each
for the distance of the averaged weights from them and for the moments of the optimiser, the second
as roots. The largest number of a tensor sets the scale; what is rounded off is soon forgotten.
Draws depend on the seed and the step alone, so that no state of random generators is kept.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from megrasp_core.errors import DataError, MegraspError
from megrasp_core.network import GraspModel

from .config import Counters, TrainConfig

TENSORS = "checkpoint.safetensors"
STATE = "checkpoint.json"

_FINE, _WIDE = torch.float8_e4m3fn, torch.float8_e5m2
"""Eight bits with more digits, and with more range: roots of second moments span nine decades."""


class _Packing:
    """Tensors in eight bits by name, and the scale of each."""

    def __init__(self) -> None:
        self.tensors: dict[str, Tensor] = {}
        self.scales: dict[str, float] = {}

    def add(self, name: str, value: Tensor, kind: torch.dtype) -> None:
        scale = max(float(value.abs().max()), 1e-30) / torch.finfo(kind).max
        self.tensors[name] = (value / scale).to(kind)
        self.scales[name] = scale


@dataclasses.dataclass(frozen=True)
class CheckpointState:
    """What a checkpoint keeps beside tensors.

    Attributes:
        config: of the run.
        counters: what the model has seen.
        validation: key of the scene and gripper of each validation pair, so that growing data
            does not change what validates.
        own_validation: whether scenes of their own validate, not held-out objects.
        hashes: of the descriptions of the grippers that the run was begun with.
        facts: further entries of the model's `config.json`.
    """

    config: TrainConfig
    counters: Counters
    validation: tuple[tuple[str, str], ...] = ()
    own_validation: bool = False
    hashes: dict[str, str] = dataclasses.field(default_factory=dict)
    facts: dict[str, Any] = dataclasses.field(default_factory=dict)


def save_checkpoint(
    folder: Path,
    model: GraspModel,
    ema: dict[str, Tensor],
    optimiser: torch.optim.AdamW,
    state: CheckpointState,
) -> None:
    """Write everything that a run needs to go on; a killed write leaves the former checkpoint.

    Args:
        folder: to write into; made where it is missing.
        model: with the weights as they are trained.
        ema: averaged weights by name.
        optimiser: whose moments are kept.
        state: all else.
    """
    folder.mkdir(parents=True, exist_ok=True)
    weights = model.state_dict()
    packing = _Packing()
    for name, average in ema.items():
        packing.add(f"ema.{name}", average - weights[name], _FINE)
    steps: dict[str, int] = {}
    for name, parameter in model.named_parameters():
        moments = optimiser.state.get(parameter)
        if moments:
            packing.add(f"first.{name}", moments["exp_avg"], _FINE)
            packing.add(f"second.{name}", moments["exp_avg_sq"].sqrt(), _WIDE)
            steps[name] = int(moments["step"])
    content = {
        "config": state.config.to_dict(),
        "counters": dataclasses.asdict(state.counters),
        "validation": state.validation,
        "own_validation": state.own_validation,
        "hashes": state.hashes,
        "facts": state.facts,
        "optimiser_steps": steps,
        "scales": packing.scales,
    }
    tensors = {f"model.{k}": v for k, v in weights.items()} | packing.tensors
    # All of it goes into the one file, so that a kill cannot leave two that do not fit; the JSON
    # beside it is for people.
    partial = folder / f".{TENSORS}.part"
    # Not `save_file`, which lets nobody but the owner read the file.
    partial.write_bytes(
        save(
            {k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()},
            {"content": json.dumps(content)},
        )
    )
    partial.replace(folder / TENSORS)
    shown = {k: v for k, v in content.items() if k not in ("optimiser_steps", "scales")}
    (folder / STATE).write_text(json.dumps(shown, indent=1) + "\n")


def read_state(folder: Path) -> CheckpointState:
    """What a checkpoint says of its run.

    Raises:
        DataError: no checkpoint, a damaged one, or one of another version.
    """
    return _state(folder, _content(folder))


def load_checkpoint(
    folder: Path, model: GraspModel, ema: dict[str, Tensor], optimiser: torch.optim.AdamW
) -> CheckpointState:
    """Fill model, averages and optimiser from a checkpoint.

    Raises:
        DataError: no checkpoint, a damaged one, or one of another network.
    """
    content = _content(folder)
    try:
        tensors = load_file(folder / TENSORS)
        scales = content["scales"]

        def unpacked(name: str) -> Tensor:
            return tensors[name].float() * scales[name]

        weights = {k[6:]: v for k, v in tensors.items() if k.startswith("model.")}
        model.load_state_dict(weights)
        for name, average in ema.items():
            average.copy_(weights[name] + unpacked(f"ema.{name}"))
        for name, parameter in model.named_parameters():
            if f"second.{name}" in tensors:
                optimiser.state[parameter] = {
                    # Where the parameter is: the fused optimiser reads it there.
                    "step": torch.tensor(
                        float(content["optimiser_steps"][name]), device=parameter.device
                    ),
                    "exp_avg": unpacked(f"first.{name}").to(parameter),
                    "exp_avg_sq": unpacked(f"second.{name}").square().to(parameter),
                }
    except (OSError, SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise _unusable(folder, error) from error
    return _state(folder, content)


def _content(folder: Path) -> dict[str, Any]:
    """The JSON of a checkpoint, as written into the tensors' file."""
    from safetensors import safe_open

    try:
        with safe_open(folder / TENSORS, framework="pt") as file:
            return json.loads((file.metadata() or {})["content"])
    except (OSError, SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise _unusable(folder, error) from error


def _state(folder: Path, content: dict[str, Any]) -> CheckpointState:
    try:
        return CheckpointState(
            TrainConfig.from_dict(content["config"]),
            Counters(**content["counters"]),
            tuple((scene, gripper) for scene, gripper in content["validation"]),
            content["own_validation"],
            content["hashes"],
            content["facts"],
        )
    except DataError:
        raise
    # Of another version: a field is missing, new, of another type or out of its range.
    except (MegraspError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unusable(folder, error) from error


def _unusable(folder: Path, error: Exception) -> DataError:
    return DataError(
        f"checkpoint in {folder} cannot be resumed ({error!r}); expected {TENSORS} written by "
        "this version for the same network. Start a new run in another --out."
    )

"""Checkpoints that resume, on this or another device: safetensors and JSON, no pickle."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ..errors import DataError
from ..network import GraspModel
from .config import Counters, TrainConfig

TENSORS = "checkpoint.safetensors"
STATE = "checkpoint.json"


def save_checkpoint(
    folder: Path,
    model: GraspModel,
    ema: dict[str, Tensor],
    optimiser: torch.optim.AdamW,
    config: TrainConfig,
    counters: Counters,
    rng: np.random.Generator,
    generator: torch.Generator,
) -> None:
    """Write everything that a run needs to go on; a killed write leaves the former checkpoint."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {f"model.{k}": v for k, v in model.state_dict().items()}
    tensors.update({f"ema.{k}": v for k, v in ema.items()})
    names = {id(p): name for name, p in model.named_parameters()}
    steps: dict[str, int] = {}
    for parameter, state in optimiser.state.items():
        name = names[id(parameter)]
        # Half the size of the weights; the second moment needs float's range, not its precision.
        tensors[f"first.{name}"] = state["exp_avg"].to(torch.bfloat16)
        tensors[f"second.{name}"] = state["exp_avg_sq"].to(torch.bfloat16)
        steps[name] = int(state["step"])
    tensors["generator"] = generator.get_state()
    content = {
        "config": config.to_dict(),
        "counters": dataclasses.asdict(counters),
        "optimiser_steps": steps,
        "rng": rng.bit_generator.state,
        "generator_device": str(generator.device),
    }
    partial = folder / f".{TENSORS}.part"
    save_file({k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()}, partial)
    partial.replace(folder / TENSORS)
    (folder / STATE).write_text(json.dumps(content, indent=1) + "\n")


def load_checkpoint(
    folder: Path,
    model: GraspModel,
    ema: dict[str, Tensor],
    optimiser: torch.optim.AdamW,
    rng: np.random.Generator,
    generator: torch.Generator,
) -> tuple[TrainConfig, Counters]:
    """Fill model, averages and optimiser from a checkpoint.

    On another kind of device the torch generator starts anew from its seed; all else is the same.

    Raises:
        DataError: no checkpoint, a damaged one, or one of another network.
    """
    try:
        content = json.loads((folder / STATE).read_text())
        tensors = load_file(folder / TENSORS)
        weights = {k[6:]: v for k, v in tensors.items() if k.startswith("model.")}
        model.load_state_dict(weights)
    except (OSError, json.JSONDecodeError, SafetensorError, RuntimeError) as error:
        raise DataError(
            f"checkpoint in {folder} cannot be resumed ({error}); expected {TENSORS} and {STATE} "
            "of the "
            "same network. Start a new run in another --out, or give the former --preset."
        ) from error
    for name in ema:
        ema[name].copy_(tensors[f"ema.{name}"])
    for name, parameter in model.named_parameters():
        if f"first.{name}" in tensors:
            optimiser.state[parameter] = {
                "step": torch.tensor(float(content["optimiser_steps"][name])),
                "exp_avg": tensors[f"first.{name}"].to(parameter),
                "exp_avg_sq": tensors[f"second.{name}"].to(parameter),
            }
    rng.bit_generator.state = content["rng"]
    if content["generator_device"] == str(generator.device):
        generator.set_state(tensors["generator"])
    return TrainConfig.from_dict(content["config"]), Counters(**content["counters"])

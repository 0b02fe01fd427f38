"""Models on disk: `<id>/model.safetensors` and `config.json`, found in a fixed order of places."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from megrasp_core.errors import ModelError
from megrasp_core.machine import is_out_of_memory

from .info import ModelInfo
from .model import GraspModel
from .precision import low_precision_pays

WEIGHTS = "model.safetensors"
CONFIG = "config.json"
FOR_ANY = "megrasp-bin"
FOR_KIND = {"hand": "megrasp-base"}
"""Kind of gripper -> the default model where that for any gripper is not the best."""


def model_folders() -> list[Path]:
    """Folders that may hold models: `$MEGRASP_MODELS`, `share/megrasp_models` of colcon prefixes,
    the checkout, the installed package.
    """
    places = [Path(p) for p in os.environ.get("MEGRASP_MODELS", "").split(":") if p]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":"):
        if prefix:
            places.append(Path(prefix) / "share" / "megrasp_models")
    here = Path(__file__).resolve()
    places += [here.parents[4] / "models", here.parents[1] / "share" / "megrasp_models"]
    return [p for p in places if p.is_dir()]


def list_models() -> list[str]:
    """Names of all models that can be found."""
    names = {p.parent.name for folder in model_folders() for p in folder.glob(f"*/{CONFIG}")}
    return sorted(names)


def default_model(kind: str | None = None) -> str:
    """Id of the model that is taken where none is asked for.

    Args:
        kind: of the gripper: parallel, adaptive or hand; None: of any.
    """
    return FOR_ANY if kind is None else FOR_KIND.get(kind, FOR_ANY)


def find_model(model: str | Path | None) -> Path:
    """Folder of a model given by its id or folder; `None` is the default model for any
    gripper.

    Raises:
        ModelError: no such model; the message lists those that exist.
    """
    name = str(model or default_model())
    candidates = [Path(name)] if "/" in name or Path(name).is_dir() else []
    candidates += [folder / name for folder in model_folders()]
    for folder in candidates:
        if (folder / CONFIG).is_file():
            return folder
    raise ModelError(
        f"model {name!r} not found; expected a folder with {CONFIG} and {WEIGHTS}, or one of "
        f"{list_models() or 'none'}. Give the folder, or set MEGRASP_MODELS to where models lie."
    )


def load_model(
    model: str | Path | None = None,
    *,
    device: str | torch.device = "cpu",
    dtype: torch.dtype = torch.float32,
) -> GraspModel:
    """Load a model for inference.

    Raises:
        ModelError: not found, or its files are damaged.
    """
    folder = find_model(model)
    try:
        info = ModelInfo.from_dict(json.loads((folder / CONFIG).read_text()))
    except (OSError, ValueError, AttributeError, TypeError, ModelError) as error:
        raise ModelError(
            f"{folder / CONFIG} cannot be read ({error}); expected JSON as `megrasp train` writes "
            "it. Restore the file from the repository or retrain."
        ) from error
    result = GraspModel(info.network)
    result.info = info
    try:
        if not (folder / WEIGHTS).is_file():
            # Reading from a pipe would never end.
            raise FileNotFoundError("no such file")
        weights = load_file(folder / WEIGHTS)
        result.load_state_dict(weights)
    except (OSError, SafetensorError, RuntimeError) as error:
        raise ModelError(
            f"weights {folder / WEIGHTS} are damaged or do not fit the config ({error}); expected "
            "the file written with it. Restore the file from the repository or retrain."
        ) from error
    if info.sha256 and info.sha256 != file_digest(folder / WEIGHTS):
        raise ModelError(
            f"weights {folder / WEIGHTS} do not match the sha256 in {CONFIG}; expected "
            f"{info.sha256}. Restore both files from the same version."
        )
    move_to(result, device, dtype)
    result.low_precision = info.low_precision and low_precision_pays(device)
    return result.eval().requires_grad_(False)


def move_to(
    model: GraspModel, device: str | torch.device, dtype: torch.dtype | None = None
) -> GraspModel:
    """The model on a device.

    Raises:
        ModelError: no such device here.
    """
    try:
        return model.to(device=torch.device(device), dtype=dtype or model.dtype)
    except (RuntimeError, AssertionError) as error:
        if is_out_of_memory(error):
            raise
        reason = str(error).strip().splitlines()[0]
        raise ModelError(
            f"device {device!r} cannot be used ({reason}); expected cpu or an available cuda "
            "device."
        ) from error


def save_model(model: GraspModel, folder: str | Path) -> Path:
    """Write weights, and as config what the model's info says."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    weights = {k: v.detach().cpu().contiguous() for k, v in model.state_dict().items()}
    # Not `save_file`, which lets nobody but the owner read the file.
    data = save(weights)
    model.info = dataclasses.replace(
        model.info,
        parameters=sum(v.numel() for v in weights.values()),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    config = json.dumps(model.info.to_dict(), indent=2) + "\n"
    files = {WEIGHTS: data, CONFIG: config.encode()}
    # A run replaces its model while others may read it: both files are whole before either moves.
    for name, value in files.items():
        (folder / f".{name}.part").write_bytes(value)
    for name in files:
        (folder / f".{name}.part").replace(folder / name)
    return folder


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()

"""The synthesizer of the node. Everything that computes runs in the worker thread."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from megrasp_core.errors import MegraspError, ModelError
from megrasp_core.machine import is_out_of_memory
from megrasp_ros.errors import ShortMemoryError

from .parameters import Settings

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

Factory = Callable[[str | None, str, int | None], Any]
"""(model or None, device, threads or None) -> an object like
megrasp_core.synthesizer.GraspSynthesizer."""


AT_ONCE = (64, 8)
"""Poses that the network takes at a time after memory was not enough for all, and then again."""

_log = logging.getLogger(__name__)


def load_synthesizer(model: str | None, device: str, threads: int | None) -> Any:
    """Load the real synthesizer (megrasp_core.synthesizer)."""
    from megrasp_core.synthesizer import GraspSynthesizer

    return GraspSynthesizer.load(model=model, device=device, threads=threads)


def resolve_device(device: str) -> str:
    """Return the torch device that `auto` stands for, other values as they are."""
    if device != "auto":
        return device
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


class Engine:
    """Loads the model when the settings ask for another; holds the gripper it is set to."""

    def __init__(self, factory: Factory = load_synthesizer) -> None:
        self._factory = factory
        self._synthesizer: Any = None
        self._loaded: tuple[str, str, int] | None = None
        self._in_use: Gripper | None = None

    @property
    def model_id(self) -> str:
        """Id of the loaded model, "" when none is."""
        synthesizer = self._synthesizer
        return "" if synthesizer is None else str(synthesizer.model.model_id)

    @property
    def device(self) -> str:
        """Device of the loaded model, "" when none is."""
        loaded = self._loaded
        return "" if loaded is None else loaded[1]

    def load_model(self, settings: Settings) -> None:
        """Load the model unless it is the loaded one. Raises ModelError."""
        key = (settings.model, resolve_device(settings.device), settings.threads)
        if self._synthesizer is not None and key == self._loaded:
            return
        self.unload()
        try:
            self._synthesizer = self._factory(
                settings.model or None, key[1], settings.threads or None
            )
        except Exception as error:
            if isinstance(error, MegraspError) or is_out_of_memory(error):
                raise
            raise ModelError(
                f"the model {settings.model or '(default)'} cannot be loaded on {key[1]}: "
                f"{type(error).__name__}: {error}. Expected a folder with config.json and "
                "model.safetensors; check the parameters model and device, or set MEGRASP_MODELS."
            ) from error
        self._loaded = key

    def unload(self) -> None:
        """Drop the model."""
        self._synthesizer = self._loaded = self._in_use = None

    def use(self, gripper: Gripper) -> None:
        """Encode the gripper in the synthesizer, unless it is the one in use."""
        if self._synthesizer is not None and self._in_use is not gripper:
            self._in_use = None
            self._synthesizer.set_gripper(gripper)
            self._in_use = gripper

    def synthesize(self, gripper: Gripper, cloud: Any, **options: Any) -> Any:
        """Return the Synthesis of a cloud for this gripper; the model must be loaded.

        Where memory is not enough it is tried again with fewer poses at a time; the notes tell.
        Raises ShortMemoryError when that does not help.
        """
        if self._synthesizer is None:
            raise ModelError(
                "no model is loaded; expected one. Set the parameter model and call again."
            )
        for at_once in (None, *AT_ONCE):
            try:
                self.use(gripper)
                if at_once is None:
                    return self._synthesizer.synthesize(cloud, **options)
                found = self._synthesizer.synthesize(cloud, at_once=at_once, **options)
                note = f"memory was short: {at_once} poses were computed at a time."
                return replace(found, notes=(*found.notes, note))
            except Exception as error:
                if not is_out_of_memory(error):
                    raise
                why = str(error) or type(error).__name__
            # Here, where the error no longer holds what was in its frames.
            _log.warning("out of memory with %s poses at a time: %s", at_once or "all", why)
            _make_room()
        raise ShortMemoryError(why, AT_ONCE[-1])

    def seen_in_training(self, gripper: Gripper) -> bool:
        """Return whether the model for this gripper was trained with its description."""
        synthesizer = self._synthesizer
        if synthesizer is None:
            return False
        return gripper.hash in synthesizer.model_for(gripper).info.trained_grippers.values()


def best_of(
    results: list[tuple[Gripper, Any]], mounted: str = "", swap_cost: float = 0.0
) -> tuple[Gripper, Any]:
    """Return the gripper whose best grasp is worth most, and its synthesis.

    Worth is the score, less `swap_cost` for another gripper than the one that is mounted; of equal
    ones that one is taken. Without any grasp it is the mounted one, else the first.
    """

    def worth(pair: tuple[Gripper, Any]) -> tuple[float, bool]:
        gripper, synthesis = pair
        on = gripper.name == mounted
        score = synthesis.grasps[0].score if synthesis.grasps else -np.inf
        return score - (0.0 if on else swap_cost), on

    return max(results, key=worth)


def _make_room() -> None:
    """Give back what nobody uses any more, that of a GPU included."""
    gc.collect()
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        torch.cuda.empty_cache()


__all__ = ["Engine", "Factory", "best_of", "load_synthesizer", "resolve_device"]

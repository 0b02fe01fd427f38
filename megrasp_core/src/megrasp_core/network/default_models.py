"""The default models, one for each kind of gripper that needs its own."""

from __future__ import annotations

import torch

from .model import GraspModel
from .storage import default_model, load_model

__all__ = ["DefaultModels"]


class DefaultModels:
    """The default models on a device; each is loaded once, when it is needed first."""

    def __init__(
        self, device: str | torch.device = "cpu", dtype: torch.dtype = torch.float32
    ) -> None:
        """Load the model for any gripper.

        Raises:
            ModelError: it is missing or damaged, or the device cannot be used.
        """
        self._device, self._dtype = device, dtype
        self._loaded: dict[str, GraspModel] = {}
        self.of(None)

    def of(self, kind: str | None) -> GraspModel:
        """The model for a kind of gripper, see `default_model`.

        Raises:
            ModelError: it is missing or damaged.
        """
        name = default_model(kind)
        if name not in self._loaded:
            self._loaded[name] = load_model(name, device=self._device, dtype=self._dtype)
        return self._loaded[name]

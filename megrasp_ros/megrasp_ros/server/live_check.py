"""Checks of parameters against what there is: grippers and models on disk, devices, cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from typing import Any

from megrasp_core.errors import MegraspError
from megrasp_ros.bounded import StillRunningError, bounded
from megrasp_ros.errors import shortened

from .gripper_shelf import LOOK, GripperShelf

FindModel = Callable[[str], object]
"""Raises MegraspError when there is no model of this name."""


def find_model(name: str) -> object:
    """Return the folder of a model. Raises ModelError."""
    from megrasp_core.network import find_model as find

    return find(name or None)


class LiveCheck:
    """What is wrong with values by the state of disk and machine, within a time limit."""

    def __init__(self, shelf: GripperShelf, find: FindModel) -> None:
        self.shelf = shelf
        self._find = find

    def wrong(self, names: Collection[str], values: dict[str, Any]) -> str:
        """Return what is wrong with the parameters `names`, "" when nothing is.

        values: of all parameters as they would be then.
        """
        checks: dict[str, Callable[[dict[str, Any]], str]] = {
            "gripper_paths": self._gripper_paths,
            "gripper": self._gripper,
            "rack": self._rack,
            "model": self._model,
            "device": _device,
            "threads": _threads,
        }
        for name, check in checks.items():
            if name not in names:
                continue
            wrong = check(values)
            if wrong:
                return f"parameter {name}: {wrong}"
        return ""

    def _gripper_paths(self, values: dict[str, Any]) -> str:
        for path in values["gripper_paths"]:
            if path and not _answers(lambda p=path: os.path.isdir(os.path.expanduser(p))):
                return (
                    f"{shortened(path, 80)!r} was given; expected a folder that exists and "
                    "answers, which holds grippers or is one"
                )
        return ""

    def _gripper(self, values: dict[str, Any]) -> str:
        return self._unknown(values["gripper"], values)

    def _rack(self, values: dict[str, Any]) -> str:
        wrong = (self._unknown(name, values) for name in values["rack"] if name)
        return next((each for each in wrong if each), "")

    def _unknown(self, name: str, values: dict[str, Any]) -> str:
        paths = [path for path in values["gripper_paths"] if path]
        try:
            self.shelf.locate(name, paths, allow_paths=True)
        except MegraspError as error:
            return str(error)
        return ""

    def _model(self, values: dict[str, Any]) -> str:
        # Outside the time limit: the first import takes longer than any disk.
        import megrasp_core.network  # noqa: F401

        name = values["model"]
        try:
            bounded(lambda: self._find(name), LOOK)
        except MegraspError as error:
            return str(error)
        except (StillRunningError, OSError, RuntimeError, ValueError) as error:
            why = f"{type(error).__name__}: {shortened(str(error), 80)}"
            return f"{shortened(name, 80)!r} was given; expected a model id or folder ({why})"
        return ""


def _answers(call: Callable[[], bool]) -> bool:
    try:
        return bounded(call, LOOK)
    except (StillRunningError, OSError, RuntimeError, ValueError):
        return False


def _device(values: dict[str, Any]) -> str:
    device: str = values["device"]
    if not device.startswith("cuda"):
        return ""
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    index = int(device.partition(":")[2] or 0)
    if index < count:
        return ""
    return f"{device!r} was given; this machine has {count} such device(s). Take auto or cpu"


def _threads(values: dict[str, Any]) -> str:
    cores = os.cpu_count() or 1
    if values["threads"] <= cores:
        return ""
    return f"{values['threads']} was given; this machine has {cores} cores; expected 0 to {cores}"

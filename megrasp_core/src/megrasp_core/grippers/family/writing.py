"""Grippers of the family as folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from megrasp_core.grippers.description import FILE_NAME


def write_gripper(destination: Path, description: dict[str, Any], model: str) -> Path:
    """Write `<name>/gripper.yaml` and the model beside it below `destination`; return the folder.

    The description comes last and in one move: a folder that has one is whole.
    """
    folder = destination / description["name"]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / description["model"]).write_text(model, encoding="utf-8")
    text = yaml.safe_dump(description, sort_keys=False, default_flow_style=None, width=110)
    unfinished = folder / f".{FILE_NAME}"
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(folder / FILE_NAME)
    return folder


def is_whole(destination: Path, description: dict[str, Any], model: str) -> bool:
    """Return whether the folder of this gripper holds exactly this gripper already."""
    folder = destination / description["name"]
    try:
        return (
            yaml.safe_load((folder / FILE_NAME).read_text(encoding="utf-8")) == description
            and (folder / description["model"]).read_text(encoding="utf-8") == model
        )
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return False

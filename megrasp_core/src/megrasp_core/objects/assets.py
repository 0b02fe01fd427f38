"""The real scans under MEGRASP_ASSETS and their division into training, validation and test."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from megrasp_core.errors import InvalidRequestError, ObjectError

from .folder import find_objects

# The terms of the other set, kit_bigbird, are not verified: it serves evaluation alone.
TRAIN_SETS = ("factory", "gso", "gso_vima", "household", "ycb")
SPLITS = ("train", "validation", "devtest")


def is_validation(name: str) -> bool:
    """Return whether a training object belongs to the tenth held back, by a hash of its name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") % 10 == 0


def asset_folder() -> Path:
    """Return MEGRASP_ASSETS/objects, or raise ObjectError when it is unset or missing."""
    root = os.environ.get("MEGRASP_ASSETS")
    if not root:
        raise ObjectError(
            "MEGRASP_ASSETS is not set; expected the folder with outside objects and grippers. "
            "Set it, or use procedural objects."
        )
    folder = Path(root) / "objects"
    if not folder.is_dir():
        raise ObjectError(
            f"MEGRASP_ASSETS is {root}, but {folder} does not exist; expected the folders train "
            "and devtest there."
        )
    return folder


def asset_objects(split: str) -> list[Path]:
    """Return the object folders of a split under MEGRASP_ASSETS, sorted by name.

    "train": the train folders of the sets TRAIN_SETS without "validation", the tenth of them held
    back by a hash of their names; "devtest": never used to train or to choose anything. Raises
    InvalidRequestError for another split, ObjectError when the assets are missing.
    """
    if split not in SPLITS:
        raise InvalidRequestError(f"unknown split {split!r}; expected one of {', '.join(SPLITS)}.")
    found = find_objects(asset_folder() / ("devtest" if split == "devtest" else "train"))
    if split == "devtest":
        return [path for _, path in found]
    ours = [(name, path) for name, path in found if name.split("/")[0] in TRAIN_SETS]
    return [path for name, path in ours if is_validation(name) == (split == "validation")]

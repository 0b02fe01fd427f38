"""Objects by name, so that a few bytes in a record bring a model back: real scans and procedural
ones.

asset/train/ycb/021_bleach_cleanser    folder below MEGRASP_ASSETS/objects
procedural/000017                      `procedural_object(17)`
obstacle/000017                        `procedural_object(17, obstacle=True)`
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from megrasp_core.errors import ObjectError
from megrasp_core.objects import ObjectModel, asset_objects, load_object, procedural_object

_ASSET = "asset/"
_PROCEDURAL = "procedural/"


class ObjectSet:
    """Named objects, loaded when asked for and kept.

    Args:
        names: as above.
        assets: folder of the assets; default the environment variable MEGRASP_ASSETS.
    """

    def __init__(self, names: Sequence[str], assets: str | Path | None = None) -> None:
        self.names = tuple(names)
        self._assets = Path(assets) if assets is not None else None
        self._loaded: dict[str, ObjectModel] = {}

    def __len__(self) -> int:
        return len(self.names)

    def __getstate__(self) -> dict[str, object]:
        # Workers load what they need: models would be megabytes in every unit.
        return {"names": self.names, "_assets": self._assets, "_loaded": {}}

    def __getitem__(self, name: str) -> ObjectModel:
        """The model of a name.

        Raises:
            ObjectError: no such name, or the assets are not there.
        """
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def restricted(self, names: Sequence[str]) -> ObjectSet:
        """The set with these names only."""
        return ObjectSet(names, self._assets)

    def _load(self, name: str) -> ObjectModel:
        match = re.fullmatch(r"(procedural|obstacle)/(\d+)", name)
        if match is not None:
            return procedural_object(int(match[2]), obstacle=match[1] == "obstacle")
        if name.startswith(_ASSET):
            root = self._assets or os.environ.get("MEGRASP_ASSETS")
            if root is None:
                raise ObjectError(
                    f"object {name} needs the asset folder; expected the environment variable "
                    "MEGRASP_ASSETS to name it. Set it, or use procedural objects alone."
                )
            return load_object(Path(root) / "objects" / name[len(_ASSET) :], name)
        raise ObjectError(
            f"unknown object {name!r}; expected asset/<split>/<set>/<name>, procedural/<number> "
            "or obstacle/<number>."
        )


def obstacle_name(number: int) -> str:
    """Name of the procedural obstacle of a seed."""
    return f"obstacle/{number:06d}"


def procedural_names(count: int, start: int = 0) -> list[str]:
    """Names of `count` procedural objects from seed `start` on."""
    return [f"{_PROCEDURAL}{number:06d}" for number in range(start, start + count)]


def asset_names(split: str) -> list[str]:
    """Names of the assets of a split ("train", "validation", "devtest"), sorted; empty without
    MEGRASP_ASSETS.
    """
    root = os.environ.get("MEGRASP_ASSETS")
    if root is None:
        return []
    base = Path(root).resolve() / "objects"
    return sorted(
        _ASSET + Path(folder).resolve().relative_to(base).as_posix()
        for folder in asset_objects(split)
    )


def training_objects(procedural: int = 60, *, assets: bool = True) -> ObjectSet:
    """Train scans (where MEGRASP_ASSETS is set; the validation tenth is not among them) and
    procedural objects.
    """
    return ObjectSet([*(asset_names("train") if assets else []), *procedural_names(procedural)])

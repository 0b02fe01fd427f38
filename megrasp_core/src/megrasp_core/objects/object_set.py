"""Objects by name, so that a few bytes in a record bring a model back: real scans, stretched
copies of them and procedural ones.

asset/train/ycb/021_bleach_cleanser    folder below MEGRASP_ASSETS/objects
stretched/000017/asset/train/ycb/...   `stretched(object, 17)`
procedural/000017                      `procedural_object(17)`
obstacle/000017                        `procedural_object(17, obstacle=True)`
"""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import ObjectError

from .assets import asset_objects
from .folder import load_object
from .model import ObjectModel
from .procedural import procedural_object
from .seeds import ObjectSeeds
from .stretched import stretched, stretched_from, stretched_name

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
        self.shares: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.names)

    def __getstate__(self) -> dict[str, object]:
        # Workers load what they need: models would be megabytes in every unit.
        return {
            "names": self.names,
            "_assets": self._assets,
            "_loaded": {},
            "shares": self.shares,
        }

    def __getitem__(self, name: str) -> ObjectModel:
        """The model of a name.

        Raises:
            ObjectError: no such name, or the assets are not there.
        """
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def folder(self, name: str) -> Path | None:
        """Folder of a scan; None for what is no scan.

        Raises:
            ObjectError: a scan, and the assets are not there.
        """
        if not name.startswith(_ASSET):
            return None
        root = self._assets or os.environ.get("MEGRASP_ASSETS")
        if not root:
            raise ObjectError(
                f"object {name} needs the asset folder; expected the environment variable "
                "MEGRASP_ASSETS to name it. Set it, or use procedural objects alone."
            )
        return Path(root) / "objects" / name[len(_ASSET) :]

    def _load(self, name: str) -> ObjectModel:
        match = re.fullmatch(r"(procedural|obstacle)/(\d+)", name)
        if match is not None:
            return procedural_object(int(match[2]), obstacle=match[1] == "obstacle")
        copy = stretched_from(name)
        if copy is not None:
            return stretched(self[copy[1]], copy[0])
        folder = self.folder(name)
        if folder is not None:
            return load_object(folder, name)
        raise ObjectError(
            f"unknown object {name!r}; expected asset/<split>/<set>/<name>, procedural/<number>, "
            "obstacle/<number> or stretched/<number>/<name of another>."
        )


SIZE_EDGES = (0.06, 0.12)
"""Between small, middle and large objects, by their longest edge (m)."""


def balanced_shares(objects: ObjectSet) -> NDArray[np.float64]:
    """Share (n,) with which each object is drawn: the same for every class of size, and in it for
    every category by the square root of how many objects it has there. Evenly over categories, a
    few gears would fill the scenes that forty household objects are to be learnt from; evenly over
    objects, the largest set would.

    Loads all objects the first time.
    """
    if objects.shares is None:
        objects.shares = _shares([objects[name] for name in objects.names])
    return objects.shares


def _shares(models: Sequence[ObjectModel]) -> NDArray[np.float64]:
    edge = [float(np.ptp(model.vertices, axis=0).max()) for model in models]
    size = np.searchsorted(SIZE_EDGES, edge)
    groups = list(zip(size.tolist(), (model.category for model in models), strict=True))
    in_group = Counter(groups)
    of_size: dict[int, float] = defaultdict(float)
    for group, count in in_group.items():
        of_size[group[0]] += np.sqrt(count)
    shares = np.array([1.0 / (np.sqrt(in_group[group]) * of_size[group[0]]) for group in groups])
    return shares / shares.sum()


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


def training_objects(
    procedural: int = 60, *, assets: bool = True, copies: int = 0, start: int = 0
) -> ObjectSet:
    """Train scans (where MEGRASP_ASSETS is set; the validation tenth is not among them),
    stretched copies of them and procedural objects.

    Args:
        procedural: so many procedural objects.
        assets: scans are among them.
        copies: stretched ones of every scan.
        start: number of the first procedural object and of the first copy.
    """
    scans = asset_names("train") if assets else []
    numbers = range(start * len(scans), (start + copies) * len(scans))
    return ObjectSet(
        [
            *scans,
            *(stretched_name(scans[number % len(scans)], number) for number in numbers),
            *procedural_names(procedural, start),
        ]
    )


def validation_objects(procedural: int = 60, *, assets: bool = True) -> ObjectSet:
    """Objects that training never sees: the validation tenth of the scans (where MEGRASP_ASSETS is
    set) and procedural objects of other seeds.
    """
    names = asset_names("validation") if assets else []
    return ObjectSet([*names, *procedural_names(procedural, ObjectSeeds.VALIDATION.start)])

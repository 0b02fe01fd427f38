"""What training asks of a scene, and where scenes come from: folders and device packs alike."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud import SceneNodes, SceneSettings, SurfaceCloud

from .device_pack import SUFFIX, DevicePack
from .records import GripperLabels
from .scene_dataset import SceneDataset


class TrainingScene(Protocol):
    """A scene as training sees it: a `SceneRecord` or a `PackedScene`."""

    @property
    def name(self) -> str:
        """Of the scene in its data set."""
        ...

    @property
    def object_names(self) -> tuple[str, ...]:
        """The objects that labels refer to by index."""
        ...

    @property
    def labels(self) -> dict[str, GripperLabels]:
        """Gripper name -> labels."""
        ...

    def without_labels(self) -> TrainingScene:
        """The scene with its surface alone."""
        ...

    def surface_cloud(self) -> SurfaceCloud:
        """The surface as preprocessing left it."""
        ...

    def chosen(self, settings: SceneSettings, seed: int = 0) -> NDArray[np.intp]:
        """Which points of the surface are nodes: seed 0 chooses as at inference, another one at
        random.
        """
        ...

    def nodes(self, settings: SceneSettings, seed: int = 0) -> SceneNodes:
        """Nodes: seed 0 gives those of inference, another one a random choice."""
        ...


class TrainingScenes(Protocol):
    """Scenes that are read when asked for."""

    @property
    def names(self) -> list[str]:
        """Scene names, in order."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> TrainingScene: ...


def open_scenes(data: str | Path | Iterable[str | Path]) -> TrainingScenes:
    """The scenes of data set folders and device packs, one after another; each is read when asked
    for.

    Raises:
        DataError: something is neither.
    """
    paths = [Path(path) for path in ([data] if isinstance(data, (str, Path)) else data)]
    return _Joined([_open(path) for path in paths])


def _open(path: Path) -> TrainingScenes:
    return DevicePack(path) if path.is_file() or path.suffix == SUFFIX else SceneDataset(path)


class _Joined:
    def __init__(self, parts: list[TrainingScenes]) -> None:
        self._parts = parts
        self._starts = [0, *accumulate(len(part) for part in parts)]

    @property
    def names(self) -> list[str]:
        return [name for part in self._parts for name in part.names]

    def __len__(self) -> int:
        return self._starts[-1]

    def __getitem__(self, index: int) -> TrainingScene:
        index = range(len(self))[index]
        place = bisect_right(self._starts, index) - 1
        return self._parts[place][index - self._starts[place]]

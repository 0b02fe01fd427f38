"""What training asks of a scene, and where scenes come from: folders and device packs alike."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Protocol

from megrasp_core.datasets.device_pack import SUFFIX, DevicePack
from megrasp_core.datasets.records import GripperLabels
from megrasp_core.datasets.storage import SceneDataset
from megrasp_core.pointcloud import SceneNodes, SceneSettings


class TrainingScene(Protocol):
    """A scene as training sees it: a `SceneRecord` or a `PackedScene`."""

    @property
    def name(self) -> str:
        """Of the scene in its data set."""
        ...

    @property
    def labels(self) -> dict[str, GripperLabels]:
        """Gripper name -> labels."""
        ...

    def nodes(self, settings: SceneSettings, seed: int = 0) -> SceneNodes:
        """Nodes: seed 0 gives those of inference, another one a random choice."""
        ...


def open_scenes(data: str | Path | Iterable[str | Path]) -> Sequence[TrainingScene]:
    """The scenes of data set folders and device packs, one after another; each is read when asked
    for.

    Raises:
        DataError: something is neither.
    """
    paths = [Path(path) for path in ([data] if isinstance(data, (str, Path)) else data)]
    return _Joined([_open(path) for path in paths])


def _open(path: Path) -> Sequence[TrainingScene]:
    return DevicePack(path) if path.is_file() or path.suffix == SUFFIX else SceneDataset(path)


class _Joined(Sequence[TrainingScene]):
    def __init__(self, parts: list[Sequence[TrainingScene]]) -> None:
        self._parts = parts
        self._starts = [0, *accumulate(len(part) for part in parts)]

    def __len__(self) -> int:
        return self._starts[-1]

    def __getitem__(self, index: int) -> TrainingScene:  # type: ignore[override]
        index = range(len(self))[index]
        place = bisect_right(self._starts, index) - 1
        return self._parts[place][index - self._starts[place]]

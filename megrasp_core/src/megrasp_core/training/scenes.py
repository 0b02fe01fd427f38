"""Training scenes in memory: what is drawn from them, and which are held out."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import mmap
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from megrasp_core.errors import DataError
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.network import ModelConfig, SceneGraph, build_graph, graph_sizes
from megrasp_core.objects import source_of
from megrasp_core.pointcloud import SceneNodes, SceneSettings, SurfaceCloud, nodes_at
from megrasp_core.storage import GripperLabels, TrainingScene, open_scenes


@dataclasses.dataclass(frozen=True)
class PoseTable:
    """Labelled poses of one gripper in one scene.

    Attributes:
        rotation: `(K, 3, 3)` float32 world_from_tcp.
        translation: `(K, 3)` float64 (m).
        target: `(K,)` float32, the share of trials that held; 0 or 1 where it was tried once.
        good: `(K,)` bool, held when it was tried first.
        owner: `(K,)` int16, the object that each was made for.
    """

    rotation: NDArray[np.float32]
    translation: NDArray[np.float64]
    target: NDArray[np.float32]
    good: NDArray[np.bool_]
    owner: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.good)

    @staticmethod
    def of(labels: GripperLabels) -> PoseTable:
        """The table of a gripper's labels."""
        matrix = np.asarray(matrix_from_pose7(labels.world_from_tcp.astype(np.float64)))
        matrix = matrix.reshape(-1, 4, 4)
        return PoseTable(
            matrix[:, :3, :3].astype(np.float32),
            matrix[:, :3, 3].copy(),
            labels.target,
            labels.label == 1,
            labels.object,
        )

    def part(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> PoseTable:
        """Some of the rows."""
        return PoseTable(
            *(getattr(self, field.name)[chosen] for field in dataclasses.fields(self))
        )


class TrainingEntry:
    """One scene: its surface, its labels and the node sets made of it so far.

    Args:
        scene: as read.
        key: place of the data set and name of the scene, by default the name.

    Attributes:
        key: tells it from all others: two data sets may hold scenes of the same name.
        name: of the scene in its data set.
        object_names: the objects that labels refer to by index.
        tables: gripper name -> labelled poses, none empty.
    """

    def __init__(self, scene: TrainingScene, key: str | None = None) -> None:
        self.key = scene.name if key is None else key
        self.name = scene.name
        self.object_names = scene.object_names
        self.tables = {
            gripper: PoseTable.of(labels)
            for gripper, labels in scene.labels.items()
            if len(labels)
        }
        self._scene = scene.without_labels()
        self._sets: dict[Hashable, tuple[NDArray[np.int32], SceneGraph]] = {}

    def of_objects(self, chosen: NDArray[np.bool_]) -> TrainingEntry:
        """The same scene with the labels of some objects `(n,)` alone; node sets are shared."""
        other = copy.copy(self)
        parts = {name: table.part(chosen[table.owner]) for name, table in self.tables.items()}
        other.tables = {name: table for name, table in parts.items() if len(table)}
        return other

    def positives(self) -> list[str]:
        """Grippers with a grasp that held."""
        return [name for name, table in self.tables.items() if table.good.any()]

    def nodes(
        self, settings: SceneSettings, network: ModelConfig, which: int = 0
    ) -> tuple[SceneNodes, SceneGraph]:
        """Nodes and graph of one of the scene's node sets: 0 are those of inference. Made when
        first asked for, then kept.
        """
        surface: SurfaceCloud = self._scene.surface_cloud()
        key = (which, settings, graph_sizes(network))
        if key not in self._sets:
            chosen = self._scene.chosen(settings, which)
            graph = build_graph(nodes_at(surface, chosen), network).narrow()
            self._sets[key] = _in_own_pages(chosen.astype(np.int32), graph)
        chosen, graph = self._sets[key]
        return nodes_at(surface, chosen.astype(np.intp)), graph.wide()


def _in_own_pages(
    chosen: NDArray[np.int32], graph: SceneGraph
) -> tuple[NDArray[np.int32], SceneGraph]:
    """The same in pages of their own, outside the heap.

    Small things that stay, between the large ones of a step that come and go, would keep the
    heap from using its gaps.
    """
    parts = [torch.from_numpy(chosen), *graph.tensors()]
    sizes = [-(-part.numel() * part.element_size() // 8) * 8 for part in parts]
    pages = mmap.mmap(-1, max(1, sum(sizes)))
    kept: list[Tensor] = []
    start = 0
    for part, size in zip(parts, sizes, strict=True):
        if part.numel():
            place = torch.frombuffer(pages, dtype=part.dtype, count=part.numel(), offset=start)
            part = place.view(part.shape).copy_(part)
        kept.append(part)
        start += size
    return kept[0].numpy(), graph.of_tensors(kept[1:])


def is_held_out(name: str) -> bool:
    """Whether an object belongs to the tenth whose grasps validate, by a hash of its name; a
    stretched copy goes with what it was made from.
    """
    digest = hashlib.sha256(f"held out {source_of(name)}".encode()).digest()
    return int.from_bytes(digest[:8], "big") % 10 == 0


def scene_keys(paths: Iterable[str | Path]) -> list[str]:
    """Keys of all scenes that data set folders and device packs hold now: place of the path and
    name of the scene.
    """
    return [
        f"{place}/{name}" for place, path in enumerate(paths) for name in open_scenes(path).names
    ]


def read_entries(
    paths: Iterable[str | Path],
    known: Mapping[str, TrainingEntry] | None = None,
    *,
    keys: Iterable[str] | None = None,
    on_scene: Callable[[], None] | None = None,
) -> dict[str, TrainingEntry]:
    """Scenes of data set folders and device packs, by their keys.

    Args:
        paths: folders and files; a folder may grow between two readings.
        known: entries of an earlier reading of the same paths, taken over as they are.
        keys: only these of `scene_keys`.
        on_scene: called after every scene.
    """
    wanted = None if keys is None else set(keys)
    entries: dict[str, TrainingEntry] = {}
    for place, path in enumerate(paths):
        dataset = open_scenes(path)
        for index, name in enumerate(dataset.names):
            key = f"{place}/{name}"
            if wanted is not None and key not in wanted:
                continue
            found = None if known is None else known.get(key)
            entries[key] = TrainingEntry(dataset[index], key) if found is None else found
            if on_scene is not None:
                on_scene()
    return entries


@dataclasses.dataclass(frozen=True)
class Division:
    """What trains and what validates.

    Attributes:
        train: entries without labels of held-out objects, those without a label left out.
        validation: entries with labels of held-out objects alone.
    """

    train: list[TrainingEntry]
    validation: list[TrainingEntry]


def divided(entries: Iterable[TrainingEntry]) -> Division:
    """Hold out a tenth of the objects: their grasps validate and are never trained with, in
    whatever scenes they lie.
    """
    division = Division([], [])
    for entry in entries:
        held = np.array([is_held_out(name) for name in entry.object_names], bool)
        for part, chosen in ((division.train, ~held), (division.validation, held)):
            kept = entry.of_objects(chosen)
            if kept.tables:
                part.append(kept)
    return division


def without_objects(
    entries: Iterable[TrainingEntry], validation: Iterable[TrainingEntry]
) -> Division:
    """All entries train; refuses objects that occur in the validation scenes as well.

    Raises:
        DataError: an object lies in scenes of both kinds.
    """
    entries = [entry for entry in entries if entry.tables]
    validation = list(validation)
    graspable = {name for entry in validation for name in _labelled(entry)}
    both = sorted(graspable & {name for entry in entries for name in _labelled(entry)})
    if both:
        raise DataError(
            f"{len(both)} objects, {both[0]} for one, have labels in the training scenes and in "
            "those for validation; expected none. Make one of them with other objects, e.g. with "
            "`megrasp data scenes --validation`, or leave the validation scenes out."
        )
    return Division(entries, validation)


def _labelled(entry: TrainingEntry) -> set[str]:
    return {
        entry.object_names[owner]
        for table in entry.tables.values()
        for owner in np.unique(table.owner)
    }

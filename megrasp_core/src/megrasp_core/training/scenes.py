"""Training scenes in memory: what is drawn from them, and which are held out."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..datasets import GripperLabels, TrainingScene, open_scenes
from ..errors import DataError
from ..lie.pose import matrix_from_pose7
from ..network import ModelConfig, SceneGraph, build_graph
from ..pointcloud import SceneNodes, SceneSettings, SurfaceCloud, nodes_at


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

    Attributes:
        name: of the scene in its data set.
        object_names: the objects that labels refer to by index.
        tables: gripper name -> labelled poses, none empty.
    """

    def __init__(self, scene: TrainingScene) -> None:
        self.name = scene.name
        self.object_names = scene.object_names
        self.tables = {
            gripper: PoseTable.of(labels)
            for gripper, labels in scene.labels.items()
            if len(labels)
        }
        self._scene = scene.without_labels()
        self._sets: dict[int, tuple[NDArray[np.int32], SceneGraph]] = {}

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
        if which not in self._sets:
            chosen = self._scene.chosen(settings, which)
            graph = build_graph(nodes_at(surface, chosen), network)
            self._sets[which] = chosen.astype(np.int32), graph.narrow()
        chosen, graph = self._sets[which]
        return nodes_at(surface, chosen.astype(np.intp)), graph.wide()


def is_held_out(name: str) -> bool:
    """Whether an object belongs to the tenth whose grasps validate, by a hash of its name."""
    digest = hashlib.sha256(f"held out {name}".encode()).digest()
    return int.from_bytes(digest[:8], "big") % 10 == 0


def read_entries(
    paths: Iterable[str | Path],
    known: Mapping[str, TrainingEntry] | None = None,
    *,
    on_scene: Callable[[], None] | None = None,
) -> dict[str, TrainingEntry]:
    """All scenes of data set folders and device packs.

    Args:
        paths: folders and files; a folder may grow between two readings.
        known: entries of an earlier reading of the same paths, taken over as they are.
        on_scene: called after every scene.

    Returns:
        Place of the path and name of the scene -> entry. Two data sets may hold scenes of the
        same name, such as a scene and the labels of a model's samples in it.
    """
    entries: dict[str, TrainingEntry] = {}
    for place, path in enumerate(paths):
        dataset = open_scenes(path)
        for index, name in enumerate(dataset.names):
            key = f"{place}/{name}"
            found = None if known is None else known.get(key)
            entries[key] = TrainingEntry(dataset[index]) if found is None else found
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

"""What one training step takes of one scene."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from megrasp_core.grippers import is_procedural
from megrasp_core.lie import PoseBatch
from megrasp_core.network import SceneGraph
from megrasp_core.pointcloud import SceneNodes, SceneSettings

from .config import TrainConfig
from .scenes import PoseTable, TrainingEntry


@dataclasses.dataclass(frozen=True)
class LabelledPoses:
    """Poses of one gripper in one scene, in centred scene coordinates.

    Attributes:
        poses: P, scene_from_tcp.
        target: `(P,)` share of trials that held.
    """

    poses: PoseBatch
    target: Tensor

    def __len__(self) -> int:
        return len(self.target)


@dataclasses.dataclass(frozen=True)
class SceneBatch:
    """One scene with poses per gripper; grippers without any are left out.

    Attributes:
        nodes: of the scene, with a graph.
        graph: levels and neighbours.
        positives: poses to diffuse.
        labelled: poses for the confidence.
        graspable: all positives' TCPs `(K, 3)` m, for the graspability.
        tried: all labels' TCPs `(K, 3)` m.
    """

    nodes: SceneNodes
    graph: SceneGraph
    positives: dict[str, LabelledPoses]
    labelled: dict[str, LabelledPoses]
    graspable: dict[str, Tensor]
    tried: dict[str, Tensor]

    @property
    def grippers(self) -> list[str]:
        """All grippers that occur."""
        return list(dict.fromkeys([*self.positives, *self.labelled, *self.graspable]))

    @property
    def noisy_poses(self) -> int:
        """How many poses are diffused."""
        return sum(len(poses) for poses in self.positives.values())

    @property
    def labelled_poses(self) -> int:
        """How many poses train the confidence."""
        return sum(len(poses) for poses in self.labelled.values())


class SceneSource:
    """Draws scenes, each for one of its grippers, so that every gripper gets its share.

    Args:
        entries: the scenes.
        config: hyper-parameters.
        settings: preprocessing.

    Attributes:
        pools: gripper -> places of the scenes that it can be drawn for: those with a grasp that
            held; for the heads alone, with any label.
        grippers: all grippers of the scenes that the config wants; every procedural one is.
    """

    def __init__(
        self,
        entries: Sequence[TrainingEntry],
        config: TrainConfig,
        settings: SceneSettings,
        hands: frozenset[str] = frozenset(),
    ) -> None:
        self.entries = list(entries)
        self._config, self._settings = config, settings
        wanted = set(config.grippers)
        pools: dict[str, list[int]] = {}
        for place, entry in enumerate(self.entries):
            # Bins in which nothing can be grasped are what the heads have to know, too.
            names = list(entry.tables) if config.heads_only else entry.positives()
            for name in names:
                if name in wanted or is_procedural(name):
                    pools.setdefault(name, []).append(place)
        self.pools = {name: np.array(pools[name]) for name in sorted(pools)}
        self.grippers = list(self.pools)
        self._shares = gripper_shares(self.grippers, config, hands)
        self._weights = object_weights(self.entries, config.rare_objects)
        self._scene_shares = {name: self._shares_of(name) for name in self.pools}

    def _shares_of(self, gripper: str) -> NDArray[np.float64] | None:
        """With which share each scene of a pool is drawn: by the weights of the objects that it
        has grasps of. None: all alike.
        """
        if self._weights is None:
            return None
        found = np.zeros(len(self.pools[gripper]))
        for row, place in enumerate(self.pools[gripper]):
            table = self.entries[place].tables[gripper]
            used = table.owner if self._config.heads_only else table.owner[table.good]
            found[row] = self._weights[place][np.unique(used)].sum()
        return found / found.sum()

    def draw(self, rng: np.random.Generator, *, confidence: bool = True) -> SceneBatch:
        """A random scene of a random gripper, with further grippers of the scene.

        Args:
            rng: decides everything.
            confidence: take labelled poses for the confidence.
        """
        config = self._config
        gripper = self.grippers[int(rng.choice(len(self.grippers), p=self._shares))]
        place = int(rng.choice(self.pools[gripper], p=self._scene_shares[gripper]))
        entry = self.entries[place]
        others = [name for name in entry.tables if name in self.pools and name != gripper]
        others = [others[i] for i in rng.permutation(len(others))[: config.grippers_per_scene - 1]]
        nodes, graph = entry.nodes(
            self._settings, config.network, 1 + int(rng.integers(config.node_sets))
        )
        nodes = varied(
            nodes,
            rng,
            jitter=config.point_jitter,
            drop_gravity=rng.random() < config.gravity_dropout,
        )
        tables = {name: entry.tables[name] for name in (gripper, *others)}
        weights = None if self._weights is None else self._weights[place]
        return scene_batch(
            nodes, graph, tables, config, rng, confidence=confidence, object_weights=weights
        )


def object_weights(
    entries: Sequence[TrainingEntry], rare: float
) -> list[NDArray[np.float64]] | None:
    """Per scene the weight (n,) of each of its objects: its number of scenes to the power of
    -`rare`, so that over all scenes an object gets its number of scenes to 1 - `rare`. None for 0.
    """
    if not rare:
        return None
    scenes = Counter(name for entry in entries for name in set(entry.object_names))
    return [np.array([scenes[name] ** -rare for name in entry.object_names]) for entry in entries]


def gripper_shares(
    names: Sequence[str], config: TrainConfig, hands: frozenset[str] = frozenset()
) -> NDArray[np.float64]:
    """Share of the scenes that is drawn for each gripper: procedural ones have
    `procedural_share` together, hands `hand_weight` times that of the others.
    """
    procedural = np.array([is_procedural(name) for name in names], bool)
    weight = np.array([config.hand_weight if name in hands else 1.0 for name in names])
    if procedural.any() and not procedural.all():
        for part, share in ((procedural, config.procedural_share), (~procedural, None)):
            total = 1.0 - config.procedural_share if share is None else share
            weight[part] *= total / weight[part].sum()
    return weight / weight.sum()


def varied(
    nodes: SceneNodes, rng: np.random.Generator, *, jitter: float, drop_gravity: bool
) -> SceneNodes:
    """Nodes with noise of a standard deviation (m) on all points, and gravity unknown."""

    def moved(points: NDArray[np.float32]) -> NDArray[np.float32]:
        noise = rng.standard_normal(points.shape, np.float32)
        return (points + jitter * noise).astype(np.float32, copy=False)

    if drop_gravity:
        nodes = dataclasses.replace(nodes, gravity=np.zeros(3, np.float32))
    if jitter:
        surface = nodes.surface
        if surface is not None:
            surface = dataclasses.replace(surface, points=moved(surface.points))
        nodes = dataclasses.replace(nodes, points=moved(nodes.points), surface=surface)
    return nodes


def scene_batch(
    nodes: SceneNodes,
    graph: SceneGraph,
    tables: Mapping[str, PoseTable],
    config: TrainConfig,
    rng: np.random.Generator,
    *,
    poses_per_gripper: int | None = None,
    confidence: bool = True,
    object_weights: NDArray[np.float64] | None = None,
) -> SceneBatch:
    """Poses of a scene: the noisy ones shared evenly by the grippers that hold anything in it.

    Args:
        nodes: of the scene.
        graph: of the nodes.
        tables: gripper -> labelled poses.
        config: amounts.
        rng: which poses.
        poses_per_gripper: instead of the config's poses per scene.
        confidence: take labelled poses for the confidence.
        object_weights: (n,) of the scene's objects; None: all alike.
    """

    def centred(translation: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy((translation - nodes.centroid).astype(np.float32))

    def poses(table: PoseTable, chosen: NDArray[np.intp]) -> LabelledPoses:
        part = table.part(chosen)
        return LabelledPoses(
            PoseBatch(torch.from_numpy(part.rotation), centred(part.translation)),
            torch.from_numpy(part.target),
        )

    holding = [name for name, table in tables.items() if table.good.any()]
    counts = dict(
        zip(holding, _even(config.poses_per_scene, len(holding)), strict=True)
        if poses_per_gripper is None
        else ((name, poses_per_gripper) for name in holding)
    )
    halves = dict(zip(tables, _even(config.confidence_poses, len(tables)), strict=True))
    positives: dict[str, LabelledPoses] = {}
    labelled: dict[str, LabelledPoses] = {}
    for name, table in tables.items():
        good, bad = np.flatnonzero(table.good), np.flatnonzero(~table.good)
        if len(good) and not config.heads_only:
            weights = (
                balance(table.owner[good], object_weights) if config.object_balanced else None
            )
            positives[name] = poses(table, rng.choice(good, counts[name], p=weights))
        if confidence and config.confidence_weight:
            half = halves[name] // 2
            chosen = [rng.permutation(part)[:half] for part in (good, bad)]
            labelled[name] = poses(table, np.concatenate(chosen))
    return SceneBatch(
        nodes,
        graph,
        positives,
        {name: part for name, part in labelled.items() if len(part)},
        {name: centred(table.translation[table.good]) for name, table in tables.items()},
        {name: centred(table.translation) for name, table in tables.items()},
    )


def _even(total: int, parts: int) -> list[int]:
    """A total in whole parts that differ by one at most."""
    return [total // parts + (place < total % parts) for place in range(parts)]


def balance(
    owner: NDArray[np.integer], object_weights: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Probabilities that give every object the same share (the paper's biased sampling), or one by
    its weight `(n,)`.
    """
    _, inverse, counts = np.unique(owner, return_inverse=True, return_counts=True)
    weights = 1.0 / counts[inverse]
    if object_weights is not None:
        weights = weights * object_weights[owner]
    return weights / weights.sum()

"""From scene records to what one training step needs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..datasets import TrainingScene
from ..lie import se3
from ..network import ModelConfig, SceneGraph, build_graph
from ..pointcloud import SceneNodes, SceneSettings
from .config import TrainConfig


@dataclasses.dataclass(frozen=True)
class LabelledPoses:
    """Poses of one gripper in one scene, in centred scene coordinates.

    Attributes:
        rotation: `(P, 3, 3)`.
        translation: `(P, 3)` m.
        label: `(P,)` float, 1 success, 0 failure.
    """

    rotation: Tensor
    translation: Tensor
    label: Tensor


@dataclasses.dataclass(frozen=True)
class SceneBatch:
    """One scene with positives to diffuse and labelled poses for the confidence, per gripper."""

    nodes: SceneNodes
    graph: SceneGraph
    positives: dict[str, LabelledPoses]
    labelled: dict[str, LabelledPoses]
    centres: dict[str, Tensor]
    """All positives' TCPs `(K, 3)`, for the graspability."""


def record_nodes(
    record: TrainingScene, *, seed: int = 0, jitter: float = 0.0, drop_gravity: bool = False
) -> SceneNodes:
    """Nodes of a stored scene.

    Args:
        record: a scene.
        seed: 0 for the nodes of inference, else a random choice of them.
        jitter: noise (m) on the points.
        drop_gravity: leave gravity unknown.
    """
    nodes = record.nodes(SceneSettings(), seed)
    if drop_gravity:
        nodes = dataclasses.replace(nodes, gravity=np.zeros(3, np.float32))
    if jitter:
        noise = np.random.default_rng(seed).normal(0.0, jitter, nodes.points.shape)
        nodes = dataclasses.replace(nodes, points=nodes.points + noise.astype(np.float32))
    return nodes


class SceneSource:
    """Draws scenes and poses for training.

    Args:
        dataset: the scenes.
        config: hyper-parameters.
        network: sizes, for the graph.
        indices: which scenes of the data set to draw from.
    """

    def __init__(
        self,
        dataset: Sequence[TrainingScene],
        config: TrainConfig,
        network: ModelConfig,
        indices: list[int],
    ) -> None:
        self._dataset = dataset
        self._config = config
        self._network = network
        self._records: dict[int, TrainingScene] = {}
        self.indices = indices

    def __len__(self) -> int:
        return len(self.indices)

    def record(self, index: int) -> TrainingScene:
        """A scene, kept in memory after its first use."""
        if index not in self._records:
            self._records[index] = self._dataset[index]
        return self._records[index]

    def draw(self, rng: np.random.Generator) -> SceneBatch:
        """A random scene that holds a positive of at least one gripper; for the heads alone, any
        label will do: bins in which nothing can be grasped are what they have to know.
        """
        while True:
            record = self.record(int(rng.choice(self.indices)))
            batch = self.batch(record, rng)
            enough = batch.positives
            if self._config.train_only == "heads":
                enough = [part for part in batch.labelled.values() if len(part.label)]
            if enough:
                return batch

    def batch(
        self, record: TrainingScene, rng: np.random.Generator, *, augment: bool = True
    ) -> SceneBatch:
        """Nodes, graph and poses of one scene."""
        config = self._config
        nodes = record_nodes(
            record,
            seed=int(rng.integers(1, 2**31)) if augment else 0,
            jitter=config.point_jitter if augment else 0.0,
            drop_gravity=augment and rng.random() < config.gravity_dropout,
        )
        positives: dict[str, LabelledPoses] = {}
        labelled: dict[str, LabelledPoses] = {}
        centres: dict[str, Tensor] = {}
        for gripper in config.grippers:
            labels = record.labels.get(gripper)
            if labels is None or not len(labels):
                continue
            good = np.flatnonzero(labels.label == 1)
            bad = np.flatnonzero(labels.label == 0)

            def poses(chosen: np.ndarray, labels=labels) -> LabelledPoses:
                seven = torch.as_tensor(labels.world_from_tcp[chosen], dtype=torch.float64)
                matrix = se3.from_pose7(seven)
                centre = torch.as_tensor(nodes.centroid)
                return LabelledPoses(
                    matrix[:, :3, :3].float(),
                    (matrix[:, :3, 3] - centre).float(),
                    torch.as_tensor(labels.label[chosen], dtype=torch.float32),
                )

            if len(good):
                weights = balance(labels.object[good]) if config.object_balanced else None
                positives[gripper] = poses(
                    rng.choice(good, config.poses_per_gripper, replace=True, p=weights)
                )
            centres[gripper] = poses(good).translation
            half = config.confidence_poses // 2
            chosen = [
                rng.choice(part, min(half, len(part)), replace=False) for part in (good, bad)
            ]
            labelled[gripper] = poses(np.concatenate(chosen).astype(int))
        return SceneBatch(
            nodes, build_graph(nodes.points, self._network), positives, labelled, centres
        )


def balance(owner: np.ndarray) -> np.ndarray:
    """Probabilities that give every object the same share (the paper's biased sampling)."""
    _, inverse, counts = np.unique(owner, return_inverse=True, return_counts=True)
    weights = 1.0 / counts[inverse]
    return weights / weights.sum()

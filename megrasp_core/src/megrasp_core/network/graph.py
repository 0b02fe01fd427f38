"""The levels of a scene and the neighbours between them.

The graph is data of its own, so that a test can hold it fixed while it moves the scene: rebuilt
from moved points
it may differ where two distances agree to rounding.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import torch
from torch import Tensor

from ..pointcloud import farthest_points, neighbours
from .config import ModelConfig


@dataclasses.dataclass(frozen=True)
class SceneGraph:
    """Nodes of every level as indices into level 0, and the neighbours in and between levels.

    Attributes:
        nodes: per level, `(n_l,)` indices into the finest level; level 0 is all of them.
        same: per level, `(n_l, k)` indices into the same level.
        down: per level but the last, `(n_{l+1}, k)` indices into level l.
        up: per level but the last, `(n_l, k_up)` indices into level l+1.
    """

    nodes: tuple[Tensor, ...]
    same: tuple[Tensor, ...]
    down: tuple[Tensor, ...]
    up: tuple[Tensor, ...]

    def to(self, device: torch.device | str) -> SceneGraph:
        """The graph on another device."""
        return SceneGraph(
            *(tuple(t.to(device) for t in getattr(self, f.name)) for f in dataclasses.fields(self))
        )


def build_graph(points: np.ndarray, config: ModelConfig) -> SceneGraph:
    """Choose the coarse nodes by farthest points and find all neighbours.

    Args:
        points: `(N, 3)` m.
        config: sizes.
    """
    points = np.asarray(points, dtype=np.float64)
    nodes = [np.arange(len(points))]
    for _ in range(1, config.levels):
        count = max(1, len(nodes[-1]) // config.level_ratio)
        nodes.append(nodes[-1][farthest_points(points[nodes[-1]], count)])
    clouds = [points[index] for index in nodes]

    def nearest(queries: np.ndarray, sources: np.ndarray, k: int) -> Tensor:
        _, index = neighbours(queries, sources, min(k, len(sources)))
        return torch.as_tensor(np.asarray(index).reshape(len(queries), -1), dtype=torch.long)

    k, k_up = config.neighbours, config.up_neighbours
    pairs = list(itertools.pairwise(clouds))
    return SceneGraph(
        nodes=tuple(torch.as_tensor(index, dtype=torch.long) for index in nodes),
        same=tuple(nearest(cloud, cloud, k) for cloud in clouds),
        down=tuple(nearest(coarse, fine, k) for fine, coarse in pairs),
        up=tuple(nearest(fine, coarse, k_up) for fine, coarse in pairs),
    )

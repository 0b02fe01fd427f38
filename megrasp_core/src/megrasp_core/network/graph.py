"""The levels of a scene and the neighbours between them.

The graph is data of its own, so that a test can hold it fixed while it moves the scene: rebuilt
from moved points it may differ where two distances agree to rounding.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError
from megrasp_core.meshes import farthest_points
from megrasp_core.pointcloud import SceneNodes, neighbours

from .config import ModelConfig


@dataclasses.dataclass(frozen=True)
class SceneGraph:
    """Nodes of every level as indices into level 0, and the neighbours in and between levels.

    Attributes:
        nodes: per level, `(n_l,)` indices into the finest level; level 0 is all of them.
        same: per level, `(n_l, k)` indices into the same level.
        down: per level but the last, `(n_{l+1}, k)` indices into level l.
        up: per level but the last, `(n_l, k_up)` indices into level l+1.
        fine: `(n_0, k_fine)` indices into the surface's points, `(n_0, 0)` for networks that do
            not look at them.
    """

    nodes: tuple[Tensor, ...]
    same: tuple[Tensor, ...]
    down: tuple[Tensor, ...]
    up: tuple[Tensor, ...]
    fine: Tensor

    def to(self, device: torch.device | str) -> SceneGraph:
        """The graph on another device."""
        return self._with(lambda index: index.to(device))

    def narrow(self) -> SceneGraph:
        """The same in the smallest integers that hold it, to be kept in large numbers."""
        return self._with(
            lambda index: index.to(
                torch.int16 if not index.numel() or int(index.max()) < 2**15 else torch.int32
            )
        )

    def wide(self) -> SceneGraph:
        """The same in the integers that the network takes; undoes `narrow`."""
        return self._with(lambda index: index.long())

    def tensors(self) -> list[Tensor]:
        """All index tensors, in the order of `of_tensors`."""
        return [*self.nodes, *self.same, *self.down, *self.up, self.fine]

    def of_tensors(self, tensors: Sequence[Tensor]) -> SceneGraph:
        """A graph like this one made of other tensors."""
        rest = iter(tensors)
        return SceneGraph(
            nodes=tuple(next(rest) for _ in self.nodes),
            same=tuple(next(rest) for _ in self.same),
            down=tuple(next(rest) for _ in self.down),
            up=tuple(next(rest) for _ in self.up),
            fine=next(rest),
        )

    def _with(self, change: Callable[[Tensor], Tensor]) -> SceneGraph:
        return self.of_tensors([change(index) for index in self.tensors()])


def graph_sizes(config: ModelConfig) -> tuple[int, ...]:
    """What of a network's sizes decides about graphs: equal sizes, equal graphs."""
    return (
        config.levels,
        config.level_ratio,
        config.neighbours,
        config.up_neighbours,
        config.fine_neighbours,
    )


def build_graph(nodes: SceneNodes, config: ModelConfig) -> SceneGraph:
    """Choose the coarse nodes by farthest points and find all neighbours.

    Args:
        nodes: of the scene; with `config.fine_neighbours` they must come with their surface.
        config: sizes.

    Raises:
        InvalidRequestError: the network looks at fine geometry and the nodes come without.
    """
    if config.fine_neighbours and nodes.surface is None:
        raise InvalidRequestError(
            "the nodes came without their surface; expected it for a network with "
            f"fine_neighbours = {config.fine_neighbours}. Make the nodes with `scene_nodes`."
        )
    points = np.asarray(nodes.points, dtype=np.float64)
    levels = [np.arange(len(points))]
    for _ in range(1, config.levels):
        count = max(1, len(levels[-1]) // config.level_ratio)
        levels.append(levels[-1][farthest_points(points[levels[-1]], count)])
    clouds = [points[index] for index in levels]

    def nearest(queries: np.ndarray, sources: np.ndarray, k: int) -> Tensor:
        _, index = neighbours(queries, sources, min(k, len(sources)))
        return torch.as_tensor(np.asarray(index).reshape(len(queries), -1), dtype=torch.long)

    k, k_up = config.neighbours, config.up_neighbours
    pairs = list(itertools.pairwise(clouds))
    return SceneGraph(
        nodes=tuple(torch.as_tensor(index, dtype=torch.long) for index in levels),
        same=tuple(nearest(cloud, cloud, k) for cloud in clouds),
        down=tuple(nearest(coarse, fine, k) for fine, coarse in pairs),
        up=tuple(nearest(fine, coarse, k_up) for fine, coarse in pairs),
        fine=torch.zeros(len(points), 0, dtype=torch.long)
        if nodes.surface is None or not config.fine_neighbours
        else nearest(points, np.asarray(nodes.surface.points, np.float64), config.fine_neighbours),
    )

"""Steerable U-Net over the scene's nodes: encoded once per cloud, its features turn with the
scene.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from .config import ModelConfig
from .convolution import Block, RadialBasis, harmonics
from .graph import SceneGraph
from .irreps import EquivariantLinear, multiplicities

INPUT_IRREPS = "3x0e+2x1o"


@dataclasses.dataclass(frozen=True)
class SceneField:
    """What the decoder reads: nodes and features of all levels, in centred scene coordinates.

    Attributes:
        points: per level `(n_l, 3)` m.
        features: per level `(n_l, token_irreps.dim)`.
        invariants: `(n_1, c)` scalars of the second level, for the graspability head.
        gravity: `(3,)` unit vector, zeros where unknown.
        plane: `(n_0,)` bool, nodes on the support plane.
    """

    points: tuple[Tensor, ...]
    features: tuple[Tensor, ...]
    invariants: Tensor
    gravity: Tensor
    plane: Tensor


class SceneEncoder(nn.Module):
    """U-Net of `Block`s with skip connections (DESIGN section 6)."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        fine, coarse = config.fine_irreps, config.coarse_irreps
        irreps = [fine] + [coarse] * (config.levels - 1)
        sizes = {"radial": config.radial_functions, "hidden": config.radial_hidden}
        self.bases = nn.ModuleList(
            RadialBasis(config.radial_functions, radius) for radius in config.radii
        )
        self.embed = EquivariantLinear(INPUT_IRREPS, _without_tensors(fine))
        self.lift = _Lift(fine)
        self.same = nn.ModuleList(
            nn.ModuleList(
                Block(irreps[level], irreps[level], irreps_target=irreps[level], **sizes)
                for _ in range(config.blocks[level])
            )
            for level in range(config.levels)
        )
        steps = range(config.levels - 1)
        self.down = nn.ModuleList(
            Block(irreps[level], irreps[level + 1], irreps_target=irreps[level], **sizes)
            for level in steps
        )
        self.up = nn.ModuleList(
            Block(irreps[level + 1], irreps[level], irreps_target=irreps[level], **sizes)
            for level in steps
        )
        self.tokens = nn.ModuleList(EquivariantLinear(ir, config.token_irreps) for ir in irreps)

    def forward(
        self, points: Tensor, normals: Tensor, plane: Tensor, gravity: Tensor, graph: SceneGraph
    ) -> SceneField:
        """Encode one scene.

        Args:
            points: `(N, 3)` m, centred.
            normals: `(N, 3)` unit, towards the sensor.
            plane: `(N,)` bool.
            gravity: `(3,)` unit vector, or zeros where unknown.
            graph: levels and neighbours.
        """
        known = gravity.square().sum()
        slope = (normals * gravity).sum(-1, keepdim=True)
        constants = torch.cat([plane[:, None].to(points.dtype), slope, known.expand_as(slope)], -1)
        vectors = torch.cat([normals, gravity.expand_as(normals)], -1)
        features = self.lift(self.embed(torch.cat([constants, vectors], -1)))
        clouds = [points[index] for index in graph.nodes]

        skips: list[Tensor] = []
        for level, blocks in enumerate(self.same):
            if level:
                features = self._pass(self.down[level - 1], level - 1, clouds[level - 1], features,
                                      clouds[level], skips[-1][_within(graph, level)],
                                      graph.down[level - 1])  # fmt: skip
            edges = self._edges(level, clouds[level], clouds[level], graph.same[level])
            for block in blocks:  # type: ignore[attr-defined]
                features = block(features, features, graph.same[level], *edges)
            skips.append(features)
        outputs = [skips[-1]]
        for level in reversed(range(len(clouds) - 1)):
            features = self._pass(self.up[level], level, clouds[level + 1], outputs[0],
                                  clouds[level], skips[level], graph.up[level])  # fmt: skip
            outputs.insert(0, features)
        tokens = tuple(head(out) for head, out in zip(self.tokens, outputs))
        scalars = multiplicities(self.config.coarse_irreps)[0]
        return SceneField(tuple(clouds), tokens, outputs[1][:, :scalars], gravity, plane)

    def _edges(
        self, level: int, sources: Tensor, targets: Tensor, index: Tensor
    ) -> tuple[Tensor, dict[int, Tensor]]:
        vectors = sources[index] - targets[:, None]
        return self.bases[level](vectors), harmonics(vectors)

    def _pass(
        self,
        block: nn.Module,
        level: int,
        sources: Tensor,
        features: Tensor,
        targets: Tensor,
        own: Tensor,
        index: Tensor,
    ) -> Tensor:
        return block(features, own, index, *self._edges(level, sources, targets, index))


class _Lift(nn.Module):
    """Adds zero channels of degree 2 to features that have none yet."""

    def __init__(self, irreps: str) -> None:
        super().__init__()
        self.extra = 5 * multiplicities(irreps)[2]

    def forward(self, features: Tensor) -> Tensor:
        return torch.cat([features, features.new_zeros(len(features), self.extra)], -1)


def _without_tensors(irreps: str) -> str:
    mul = multiplicities(irreps)
    return f"{mul[0]}x0e+{mul[1]}x1o"


def _within(graph: SceneGraph, level: int) -> Tensor:
    """Where the nodes of a level stand in the list of the level above."""
    above, here = graph.nodes[level - 1], graph.nodes[level]
    order = torch.empty(int(above.max()) + 1, dtype=torch.long, device=above.device)
    order[above] = torch.arange(len(above), device=above.device)
    return order[here]

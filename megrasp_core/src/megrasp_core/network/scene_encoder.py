"""Steerable U-Net over the scene's nodes: encoded once per cloud, its features turn with the
scene.
"""

from __future__ import annotations

import dataclasses
import functools

import torch
from torch import Tensor, nn

from .config import ModelConfig
from .convolution import Block, Edges, RadialBasis, gathered, harmonics
from .graph import SceneGraph
from .irreps import EquivariantLinear, Steerable, multiplicities, pack, scalars_of

INPUT_IRREPS = "3x0e+2x1o"


@dataclasses.dataclass(frozen=True)
class SceneField:
    """What the decoder reads: nodes and features of all levels, in centred scene coordinates.

    Attributes:
        points: per level `(n_l, 3)` m.
        features: per level `(n_l, token_irreps.dim)`, e3nn's layout.
        invariants: `(n_1, c)` scalars of the second level, for the graspability head.
        gravity: `(3,)` unit vector, zeros where unknown.
        plane: `(n_0,)` bool, nodes on the support plane.
        coarse_plane: `(n_1,)` bool, the same of the second level.
    """

    points: tuple[Tensor, ...]
    features: tuple[Tensor, ...]
    invariants: Tensor
    gravity: Tensor
    plane: Tensor
    coarse_plane: Tensor


@dataclasses.dataclass(frozen=True)
class SurfaceInput:
    """Points of the scene as tensors.

    Attributes:
        points: `(N, 3)` m, centred.
        normals: `(N, 3)` unit, towards the sensor.
        plane: `(N,)` bool.
    """

    points: Tensor
    normals: Tensor
    plane: Tensor


class SceneEncoder(nn.Module):
    """U-Net of `Block`s with skip connections (docs/architecture.md, "Network").

    With `config.fine_neighbours` the first block of the finest level gathers voxel points of the
    surface instead of neighbouring nodes, so that detail finer than the nodes' spacing comes in.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        fine, coarse = config.fine_irreps, config.coarse_irreps
        irreps = [fine] + [coarse] * (config.levels - 1)
        make = functools.partial(
            Block, radial=config.radial_functions, hidden=config.radial_hidden
        )
        self.bases = nn.ModuleList(
            RadialBasis(config.radial_functions, radius) for radius in config.radii
        )
        self.fine_basis = RadialBasis(config.radial_functions, config.fine_radius)
        embedded = _without_tensors(fine)
        self._tensors = multiplicities(fine)[2]
        self.embed = EquivariantLinear(INPUT_IRREPS, embedded)
        first = make(fine, fine, irreps_target=fine)
        if config.fine_neighbours:
            lift = (multiplicities(fine)[1], self._tensors)
            first = make(embedded, fine, irreps_target=fine, lift=lift)
        self.same = nn.ModuleList(
            nn.ModuleList(
                first
                if level == block == 0
                else make(irreps[level], irreps[level], irreps_target=irreps[level])
                for block in range(config.blocks[level])
            )
            for level in range(config.levels)
        )
        steps = range(config.levels - 1)
        self.down = nn.ModuleList(
            make(irreps[level], irreps[level + 1], irreps_target=irreps[level]) for level in steps
        )
        self.up = nn.ModuleList(
            make(irreps[level + 1], irreps[level], irreps_target=irreps[level]) for level in steps
        )
        self.tokens = nn.ModuleList(EquivariantLinear(ir, config.token_irreps) for ir in irreps)

    def forward(
        self,
        nodes: SurfaceInput,
        surface: SurfaceInput | None,
        gravity: Tensor,
        graph: SceneGraph,
    ) -> SceneField:
        """Encode one scene.

        Args:
            nodes: the N nodes of the finest level.
            surface: the points that the nodes were chosen from; read with
                `config.fine_neighbours` alone.
            gravity: `(3,)` unit vector, or zeros where unknown.
            graph: levels and neighbours.
        """
        features = self._lifted(self._embedded(nodes, gravity))
        clouds = [nodes.points[index] for index in graph.nodes]

        skips: list[Steerable] = []
        for level, blocks in enumerate(self.same):
            if level:
                own = _rows(skips[-1], _within(graph, level))
                edges = self._edges(
                    self.bases[level - 1], clouds[level - 1], clouds[level], graph.down[level - 1]
                )
                features = self.down[level - 1](features, own, edges)
            edges = self._edges(self.bases[level], clouds[level], clouds[level], graph.same[level])
            for index, block in enumerate(blocks):  # type: ignore[arg-type]
                if level == index == 0 and self.config.fine_neighbours and surface is not None:
                    near = self._edges(self.fine_basis, surface.points, clouds[0], graph.fine)
                    features = block(self._embedded(surface, gravity), features, near)
                else:
                    features = block(features, features, edges)
            skips.append(features)
        outputs = [skips[-1]]
        for level in reversed(range(len(clouds) - 1)):
            edges = self._edges(
                self.bases[level], clouds[level + 1], clouds[level], graph.up[level]
            )
            outputs.insert(0, self.up[level](outputs[0], skips[level], edges))
        tokens = tuple(pack(head(out)) for head, out in zip(self.tokens, outputs))
        return SceneField(
            tuple(clouds),
            tokens,
            scalars_of(outputs[1]),
            gravity,
            nodes.plane,
            nodes.plane[graph.nodes[1]],
        )

    def _embedded(self, cloud: SurfaceInput, gravity: Tensor) -> Steerable:
        """Features of degrees 0 and 1: plane flag, slope against gravity, whether gravity is
        known; normal and gravity.
        """
        known = gravity.square().sum()
        slope = (cloud.normals * gravity).sum(-1, keepdim=True)
        plane = cloud.plane[:, None].to(cloud.points.dtype)
        constants = torch.cat([plane, slope, known.expand_as(slope)], -1)
        vectors = torch.stack([cloud.normals, gravity.expand_as(cloud.normals)], -1)
        return self.embed({0: constants.unsqueeze(-2), 1: vectors})

    def _lifted(self, features: Steerable) -> Steerable:
        """The same with zero channels of degree 2."""
        scalars = features[0]
        return {**features, 2: scalars.new_zeros(len(scalars), 5, self._tensors)}

    def _edges(self, basis: nn.Module, sources: Tensor, targets: Tensor, index: Tensor) -> Edges:
        vectors = gathered(sources, index) - targets[:, None]
        return Edges(index, basis(vectors), harmonics(vectors))


def _without_tensors(irreps: str) -> str:
    mul = multiplicities(irreps)
    return f"{mul[0]}x0e+{mul[1]}x1o"


def _rows(features: Steerable, index: Tensor) -> Steerable:
    return {degree: part.index_select(0, index) for degree, part in features.items()}


def _within(graph: SceneGraph, level: int) -> Tensor:
    """Where the nodes of a level stand in the list of the level above."""
    above, here = graph.nodes[level - 1], graph.nodes[level]
    order = torch.empty(int(above.max()) + 1, dtype=torch.long, device=above.device)
    order[above] = torch.arange(len(above), device=above.device)
    return order[here]

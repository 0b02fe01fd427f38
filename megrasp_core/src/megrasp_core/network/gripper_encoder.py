"""Tokens of the gripper: points of its open and closed geometry in the TCP frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from .config import ModelConfig


@dataclasses.dataclass(frozen=True)
class GripperCode:
    """A gripper as the decoder reads it, or one gripper per pose with a leading dimension P.

    Attributes:
        points: `(G, 3)` or `(P, G, 3)` m, TCP frame.
        tokens: `(G, width)` or `(P, G, width)`.
        probes: `(S, 3)` or `(P, S, 3)` m, the points that decide which scene nodes are near.
    """

    points: Tensor
    tokens: Tensor
    probes: Tensor

    @staticmethod
    def of_poses(codes: Sequence[GripperCode], counts: Sequence[int]) -> GripperCode:
        """One gripper per pose: the first code for the first `counts[0]` poses, and so on.

        The codes must have equally many tokens.
        """
        if len(codes) == 1:
            return codes[0]

        def repeated(parts: list[Tensor]) -> Tensor:
            repeats = torch.as_tensor(list(counts), device=parts[0].device)
            return torch.stack(parts).repeat_interleave(repeats, 0)

        return GripperCode(
            repeated([code.points for code in codes]),
            repeated([code.tokens for code in codes]),
            repeated([code.probes for code in codes]),
        )


class Fourier(nn.Module):
    """Sines and cosines of coordinates in octaves, with the coordinates themselves."""

    def __init__(self, scale: float, octaves: int) -> None:
        super().__init__()
        self.scale, self.octaves = scale, octaves
        self.dim = 3 + 6 * octaves

    def forward(self, points: Tensor) -> Tensor:
        """`(..., 3)` m to `(..., dim)`."""
        x = points / self.scale
        waves = torch.cat([x * (math.pi * 0.5 * 2.0**k) for k in range(self.octaves)], -1)
        return torch.cat([x, waves.sin(), waves.cos()], -1)


class GripperEncoder(nn.Module):
    """Two attention layers over the tokens of the open and the closed posture."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        width = config.width
        self.selection_tokens = config.selection_tokens
        self.fourier = Fourier(config.position_scale, config.position_octaves)
        self.embed = nn.Sequential(
            nn.Linear(self.fourier.dim + 7, 2 * width), nn.SiLU(), nn.Linear(2 * width, width)
        )
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(
                width,
                config.heads,
                2 * width,
                dropout=0.0,
                activation="gelu",
                batch_first=True,
                norm_first=True,
            )
            for _ in range(config.gripper_layers)
        )

    def forward(
        self, points: Tensor, normals: Tensor, closed: Tensor, displacement: Tensor
    ) -> list[GripperCode]:
        """Encode K grippers.

        Args:
            points: `(K, G, 3)` m, TCP frame, open and closed.
            normals: `(K, G, 3)` unit.
            closed: `(K, G)` bool.
            displacement: `(K, G, 3)` m, from the open to the closed place of the same surface
                point.
        """
        flag = closed.unsqueeze(-1).to(points.dtype)
        motion = displacement / self.fourier.scale
        x = self.embed(torch.cat([self.fourier(points), normals, motion, flag], -1))
        for layer in self.layers:
            x = layer(x)
        return [
            GripperCode(cloud, tokens, cloud[spread(cloud, self.selection_tokens)])
            for cloud, tokens in zip(points, x, strict=True)
        ]


def spread(points: Tensor, count: int) -> Tensor:
    """Indices of `count` farthest points of `(G, 3)`, from the one nearest to the TCP on."""
    distance = points.norm(dim=-1)
    chosen = [int(distance.argmin())]
    distance = (points - points[chosen[0]]).norm(dim=-1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).norm(dim=-1))
    return torch.tensor(chosen, dtype=torch.long, device=points.device)

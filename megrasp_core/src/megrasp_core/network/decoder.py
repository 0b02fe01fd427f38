"""The decoder: scene nodes near the posed gripper, seen from its TCP, attended to by the
gripper's tokens.

With r = (R, t) = world_from_tcp every chosen node is taken to x' = R^T (x - t), f' = D(R^T) f.
There everything is invariant, so that plain dense layers follow and the prediction, expressed in
the TCP frame, is exactly equivariant (docs/architecture.md, "Network").
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import cast

import torch
from torch import Tensor, nn

from megrasp_core.lie import PoseBatch, wigner

from .config import ModelConfig
from .convolution import gathered
from .gripper_encoder import Fourier, GripperCode
from .kernels import can_compile, nearest_points
from .scene_encoder import SceneField

KEYS = 16
"""Softmax over another number than a multiple of this takes much longer on a CPU."""
FAR = 1e6
"""Squared distance, in units of the position scale, of keys that are there to make up the number:
their weight is 0 exactly."""


@dataclasses.dataclass(frozen=True)
class NearNodes:
    """What P poses see around them; nothing of it needs gradients.

    Attributes:
        index: per level `(P, n)` nodes.
        position: `(P, S, fourier)` their places in the TCP frame, embedded; all levels together.
        gravity: `(P, 4)` gravity in the TCP frame and whether it is known.
        matrices: D(R^T) for l = 0, 1, 2.
        query: `(G, 5)` or `(P, G, 5)` and
        key: `(P, S', 5)`, the distances of gripper tokens and nodes (`distance_factors`).
    """

    index: tuple[Tensor, ...]
    position: Tensor
    gravity: Tensor
    matrices: tuple[Tensor, Tensor, Tensor]
    query: Tensor
    key: Tensor


class NoiseEmbedding(nn.Module):
    """Fourier features of log s through a small network."""

    def __init__(self, width: int, s_min: float) -> None:
        super().__init__()
        self.s_min = s_min
        self.net = nn.Sequential(
            nn.Linear(17, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )

    def forward(self, s: Tensor) -> Tensor:
        """`(P,)` to `(P, width)`."""
        x = (s.log() / math.log(self.s_min)).unsqueeze(-1)
        waves = torch.cat([x * (math.pi * 2.0**k / 2) for k in range(8)], -1)
        return self.net(torch.cat([x, waves.sin(), waves.cos()], -1))


class AttentionBlock(nn.Module):
    """Cross-attention from gripper tokens to scene tokens, then a feed-forward layer; FiLM on
    both.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_q = nn.LayerNorm(width, elementwise_affine=False)
        self.norm_kv = nn.LayerNorm(width)
        self.norm_ff = nn.LayerNorm(width, elementwise_affine=False)
        self.film = nn.Linear(width, 4 * width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.project = nn.Linear(width, width)
        self.pool = nn.Linear(width, width)
        self.feed = nn.Sequential(
            nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        nn.init.zeros_(self.film.weight)
        nn.init.zeros_(self.film.bias)
        # One learned range per head: a head may look far or only at what nearly touches.
        self.log_range = nn.Parameter(torch.linspace(0.0, 5.0, heads))

    def forward(
        self, x: Tensor, key_value: Tensor, near_q: Tensor, near_k: Tensor, time: Tensor
    ) -> Tensor:
        """Attend.

        Args:
            x: `(P, G, width)` gripper tokens.
            key_value: `(P, S, 2 width)` keys and values of the scene tokens (`keys_and_values`).
            near_q: `(G, 5)` or `(P, G, 5)` and
            near_k: `(P, S, 5)`, whose product is minus the squared distance (`distance_factors`).
            time: `(P, width)` noise embedding.
        """
        scale_q, shift_q, scale_f, shift_f = self.film(time).unsqueeze(1).chunk(4, -1)
        q = self.query(torch.addcmul(shift_q, self.norm_q(x), 1 + scale_q))
        x = x + self.project(self._attend(q, key_value, near_q, near_k))
        y = torch.addcmul(shift_f, self.norm_ff(x), 1 + scale_f)
        return x + self.feed(y) + self.pool(y.mean(1, keepdim=True))

    def _attend(self, q: Tensor, key_value: Tensor, near_q: Tensor, near_k: Tensor) -> Tensor:
        """Attention with logits q.k / sqrt(d) - range |x_q - x_k|^2, the distance as further
        channels.

        So no `(P, G, S)` distances are made and added, which costs more than they do as channels.
        Plain products and a softmax: on a CPU a fused attention takes twice as long in training.
        """
        p, g, width = q.shape
        heads, d = self.heads, width // self.heads
        near_q = near_q.view(-1, 1, g, near_q.shape[-1]) * self.log_range.exp()[:, None, None]
        q = q.view(p, g, heads, d).transpose(1, 2) / d**0.5
        k, v = key_value.view(p, -1, 2, heads, d).permute(2, 0, 3, 1, 4)
        if q.dtype == torch.bfloat16:
            near_q, near_k = _in_halves(near_q, near_k)
        q = torch.cat([q, near_q.expand(p, *near_q.shape[1:])], -1)
        k = torch.cat([k, near_k.unsqueeze(1).expand(p, heads, -1, -1)], -1)
        weights = (q.flatten(0, 1) @ k.flatten(0, 1).transpose(1, 2)).softmax(-1)
        out = weights.to(v.dtype) @ v.flatten(0, 1)
        return out.view(p, heads, g, d).transpose(1, 2).reshape(p, g, width)


def _in_halves(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """Factors in bfloat16 whose inner product is that of the given ones to 16 bits: each number as
    the sum of two, without the product of the small ones; one channel of zeros makes the number
    of channels even.
    """
    (a, b), (c, d) = (
        (high, (x - high.to(x.dtype)).to(torch.bfloat16))
        for x, high in ((x, x.to(torch.bfloat16)) for x in (left, right))
    )
    pad = (0, 1)
    return (
        nn.functional.pad(torch.cat([a, a, b], -1), pad),
        nn.functional.pad(torch.cat([c, d, c], -1), pad),
    )


def keys_and_values(blocks: Iterable[AttentionBlock], scene: Tensor) -> tuple[Tensor, ...]:
    """Keys and values `(P, S, 2 width)` of the scene tokens `(P, S, width)` for every block, in
    one product: the blocks' norms differ by scale and shift alone, which go into the weights.
    """
    blocks = tuple(blocks)
    weights, biases = [], []
    for block in blocks:
        layer, norm = block.key_value, block.norm_kv
        weights.append(layer.weight * norm.weight)
        biases.append(torch.addmv(layer.bias, layer.weight, norm.bias))
    normed = nn.functional.layer_norm(scene, scene.shape[-1:], eps=blocks[0].norm_kv.eps)
    both = nn.functional.linear(normed, torch.cat(weights), torch.cat(biases))
    return both.chunk(len(blocks), -1)


class Decoder(nn.Module):
    """From a scene field, a gripper and noisy poses to one feature vector per pose."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        dim = wigner.irreps_dim(config.token_irreps)
        self.fourier = Fourier(config.position_scale, config.position_octaves)
        self.embed_feature = nn.ModuleList(nn.Linear(dim, width) for _ in config.scene_tokens)
        self.embed_position = nn.Linear(self.fourier.dim, width)
        self.embed_gravity = nn.Linear(4, width)
        self.gripper = nn.Linear(width, width)
        self.time = NoiseEmbedding(width, config.s_min)
        self.blocks = nn.ModuleList(
            AttentionBlock(width, config.heads) for _ in range(config.decoder_blocks)
        )
        self.score = nn.Linear(width, 1)
        self.dim = 2 * width
        self.compiled = False
        """Use compiled kernels where they can be used."""

    def near_nodes(self, field: SceneField, code: GripperCode, poses: PoseBatch) -> NearNodes:
        """The nodes that each pose looks at: those nearest to the posed gripper."""
        rotation, translation = poses.rotation, poses.translation
        with torch.no_grad(), torch.autocast(rotation.device.type, enabled=False):
            inverse = rotation.transpose(1, 2)
            probes = code.probes @ inverse + translation[:, None]
            index, places = [], []
            for points, count in zip(field.points, self.config.scene_tokens, strict=True):
                near = self._nearest(points, probes, min(count, len(points)))
                index.append(near)
                places.append((gathered(points, near) - translation[:, None]) @ rotation)
            place = torch.cat(places, 1)
            gravity = field.gravity @ rotation
            known = field.gravity.square().sum().expand(len(gravity), 1)
            near_q, near_k = distance_factors(code.points, place, self.fourier.scale)
            return NearNodes(
                tuple(index),
                self.fourier(place),
                torch.cat([gravity, known], -1),
                wigner.wigner_matrices(inverse),
                near_q,
                near_k,
            )

    def _nearest(self, points: Tensor, probes: Tensor, count: int) -> Tensor:
        find = nearest_points if self.compiled and can_compile(points) else nearest_nodes
        return find(points, probes, count)

    def scene_tokens(self, field: SceneField, near: NearNodes) -> Tensor:
        """Tokens `(P, S', width)` of the near nodes and of gravity, then zeros that nobody
        attends to.

        The embedding of a feature that was turned into the TCP frame is the feature times a
        matrix made of embedding and rotation: W D(R^T) f. So a pose's matrix is made once and no
        feature is turned.
        """
        with torch.autocast(near.gravity.device.type, enabled=False):
            positions = self.embed_position(near.position).split(
                [index.shape[1] for index in near.index], 1
            )
            tokens = [
                torch.baddbmm(
                    position + embed.bias,
                    gathered(features, index),
                    self._turned(cast(nn.Linear, embed).weight.T, near),
                )
                for embed, features, index, position in zip(
                    self.embed_feature, field.features, near.index, positions, strict=True
                )
            ]
            gravity = self.embed_gravity(near.gravity)[:, None]
            rest = near.key.shape[1] - near.position.shape[1] - 1
            return torch.cat(
                [*tokens, gravity, gravity.new_zeros(len(gravity), rest, gravity.shape[2])], 1
            )

    def _turned(self, weight: Tensor, near: NearNodes) -> Tensor:
        """Per pose the transposed product of an embedding and D(R^T), `(P, dim, width)`; weight:
        the transposed embedding `(dim, width)`.
        """
        poses, width = len(near.gravity), weight.shape[1]
        rows: list[Tensor] = []
        blocks = wigner.blocks_of(self.config.token_irreps)
        parts = weight.split([mul * (2 * degree + 1) for mul, degree in blocks])
        for (mul, degree), part in zip(blocks, parts, strict=True):
            size = 2 * degree + 1
            if degree == 0:
                rows.append(part.expand(poses, -1, -1))
                continue
            # (P, i, j) x (j, mul width): D on the components, for all channels at once.
            flat = part.view(mul, size, width).transpose(0, 1).reshape(size, -1)
            turned = (near.matrices[degree].transpose(1, 2).reshape(-1, size) @ flat).view(
                poses, size, mul, width
            )
            rows.append(turned.transpose(1, 2).reshape(poses, -1, width))
        return torch.cat(rows, 1)

    def forward(
        self,
        field: SceneField,
        code: GripperCode,
        poses: PoseBatch,
        s: Tensor,
        near: NearNodes | None = None,
    ) -> Tensor:
        """One vector per pose.

        Args:
            field: the scene.
            code: the gripper, or one gripper a pose.
            poses: P, scene_from_tcp.
            s: `(P,)` noise levels.
            near: the poses' nodes, where they are known already.

        Returns:
            `(P, 2 width)`.
        """
        near = near or self.near_nodes(field, code, poses)
        scene = self.scene_tokens(field, near)
        time = self.time(s)
        x = self.gripper(code.tokens).expand(len(poses), -1, -1)
        known = keys_and_values(self.blocks, scene)  # type: ignore[arg-type]
        for block, key_value in zip(self.blocks, known, strict=True):
            x = block(x, key_value, near.query, near.key, time)
        weights = self.score(x).softmax(1)
        return torch.cat([(x * weights).sum(1), x.mean(1)], -1)


def distance_factors(queries: Tensor, keys: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Factors `(..., G, 5)`, `(P, S', 5)` whose inner products are -|q - k|^2 in units of `scale`.

    After the keys come that of the gravity token, which has no place and gets a zero factor, so
    that no head loses it, and some infinitely far away, so that their number is a multiple of
    `KEYS`.

    Args:
        queries: `(..., G, 3)` m.
        keys: `(P, S, 3)` m.
        scale: length (m).
    """
    q, k = queries / scale, keys / scale
    q2, k2 = q.square().sum(-1, keepdim=True), k.square().sum(-1, keepdim=True)
    near_q = torch.cat([2 * q, -q2, -torch.ones_like(q2)], -1)
    near_k = torch.cat([k, torch.ones_like(k2), k2], -1)
    rest = k.new_zeros(len(keys), 1 + -(keys.shape[1] + 1) % KEYS, 5)
    rest[:, 1:, 4] = FAR
    return near_q, torch.cat([near_k, rest], 1)


def nearest_nodes(points: Tensor, probes: Tensor, count: int) -> Tensor:
    """Indices `(P, count)` of the nodes nearest to any probe of a pose.

    Args:
        points: `(n, 3)` m.
        probes: `(P, S, 3)` m.
        count: nodes per pose.
    """
    if count >= len(points):
        return torch.arange(len(points), device=points.device).expand(len(probes), -1)
    # |x - q|^2 = |x|^2 - 2 x.q + |q|^2 as one matrix product: 3 times faster than cdist for small
    # dimensions.
    flat = probes.reshape(-1, 3)
    lifted = torch.cat(
        [-2 * flat, flat.square().sum(-1, keepdim=True), torch.ones_like(flat[:, :1])], -1
    )
    basis = torch.cat(
        [points, torch.ones_like(points[:, :1]), points.square().sum(-1, keepdim=True)], -1
    )
    squared = (lifted @ basis.T).view(len(probes), -1, len(points)).amin(1)
    return squared.topk(count, dim=-1, largest=False, sorted=False).indices

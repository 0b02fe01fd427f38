"""The decoder: scene nodes near the posed gripper, seen from its TCP, attended to by the
gripper's tokens.

With r = (R, t) = world_from_tcp every chosen node is taken to x' = R^T (x - t), f' = D(R^T) f.
There everything
is invariant, so that plain dense layers follow and the prediction, expressed in the TCP frame, is
exactly
equivariant (DESIGN section 6).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ..lie import wigner
from .config import ModelConfig
from .gripper_encoder import Fourier, GripperCode
from .scene_encoder import SceneField


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
        self, x: Tensor, scene: Tensor, near_q: Tensor, near_k: Tensor, time: Tensor
    ) -> Tensor:
        """Attend.

        Args:
            x: `(P, G, width)` gripper tokens.
            scene: `(P, S, width)` scene tokens.
            near_q: `(G, 5)` and
            near_k: `(P, S, 5)`, whose product is minus the squared distance (`distance_factors`).
            time: `(P, width)` noise embedding.
        """
        scale_q, shift_q, scale_f, shift_f = self.film(time).unsqueeze(1).chunk(4, -1)
        q = self.query(self.norm_q(x) * (1 + scale_q) + shift_q)
        k, v = self.key_value(self.norm_kv(scene)).chunk(2, -1)
        with torch.autocast(x.device.type, enabled=False):
            out = self._attend(
                q.to(near_q.dtype), k.to(near_q.dtype), v.to(near_q.dtype), near_q, near_k
            )
        x = x + self.project(out)
        y = self.norm_ff(x) * (1 + scale_f) + shift_f
        return x + self.feed(y) + self.pool(y.mean(1, keepdim=True))

    def _attend(self, q: Tensor, k: Tensor, v: Tensor, near_q: Tensor, near_k: Tensor) -> Tensor:
        """Attention with logits q.k / sqrt(d) - range |x_q - x_k|^2, the distance as five more
        channels.

        So no `(P, G, S)` mask is made, which costs more than the attention itself on a CPU.
        """
        p, g, width = q.shape
        d = width // self.heads
        padded = d + 5 + (-(d + 5)) % 8
        scale = self.log_range.exp()[:, None, None] * padded**0.5

        def split(x: Tensor, own: float, near: Tensor) -> Tensor:
            x = x.reshape(p, -1, self.heads, d).transpose(1, 2) * own
            near = near.expand(*x.shape[:-1], 5)
            return nn.functional.pad(torch.cat([x, near], -1), (0, padded - d - 5))

        q = split(q, (padded / d) ** 0.5, near_q * scale)
        k = split(k, 1.0, near_k.unsqueeze(1))
        v = nn.functional.pad(v.reshape(p, -1, self.heads, d).transpose(1, 2), (0, padded - d))
        out = nn.functional.scaled_dot_product_attention(q, k, v)[..., :d]
        return out.transpose(1, 2).reshape(p, g, width)


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

    def scene_tokens(
        self, field: SceneField, code: GripperCode, rotation: Tensor, translation: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Tokens `(P, S, width)` and their places `(P, S, 3)` m in the TCP frame."""
        with torch.autocast(rotation.device.type, enabled=False):
            inverse = rotation.transpose(1, 2)
            probes = code.points[code.selection] @ inverse + translation[:, None]
            matrices = wigner.wigner_matrices(inverse)
            features, places = [], []
            for level, count in enumerate(self.config.scene_tokens):
                points = field.points[level]
                with torch.no_grad():
                    near = nearest_nodes(points, probes, min(count, len(points)))
                places.append((points[near] - translation[:, None]) @ rotation)
                turned = wigner.rotate(
                    field.features[level][near], self.config.token_irreps, inverse, matrices
                )
                features.append(turned)
            place = torch.cat(places, 1)
            position = self.embed_position(self.fourier(place))
            gravity = field.gravity @ rotation
            known = field.gravity.square().sum().expand(len(gravity), 1)
            extra = self.embed_gravity(torch.cat([gravity, known], -1))
        token = torch.cat([embed(f) for embed, f in zip(self.embed_feature, features)], 1)
        token = torch.cat([token + position, extra[:, None]], 1)
        return token, torch.cat([place, torch.zeros_like(place[:, :1])], 1)

    def forward(
        self,
        field: SceneField,
        code: GripperCode,
        rotation: Tensor,
        translation: Tensor,
        s: Tensor,
    ) -> Tensor:
        """One vector per pose.

        Args:
            field: the scene.
            code: the gripper.
            rotation: `(P, 3, 3)` scene_from_tcp.
            translation: `(P, 3)` m.
            s: `(P,)` noise levels.

        Returns:
            `(P, 2 width)`.
        """
        scene, place = self.scene_tokens(field, code, rotation, translation)
        with torch.autocast(rotation.device.type, enabled=False):
            near_q, near_k = distance_factors(code.points, place, self.fourier.scale)
        time = self.time(s)
        x = self.gripper(code.tokens).expand(len(rotation), -1, -1)
        for block in self.blocks:
            x = block(x, scene, near_q, near_k, time)
        weights = self.score(x).softmax(1)
        return torch.cat([(x * weights).sum(1), x.mean(1)], -1)


def distance_factors(queries: Tensor, keys: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Factors `(G, 5)`, `(P, S, 5)` whose inner products are -|q - k|^2 in units of `scale`.

    The last key is the gravity token: it has no place and gets a zero factor, so that no head
    loses it.
    """
    q, k = queries / scale, keys / scale
    q2, k2 = q.square().sum(-1, keepdim=True), k.square().sum(-1, keepdim=True)
    near_q = torch.cat([2 * q, -q2, -torch.ones_like(q2)], -1)
    near_k = torch.cat([k, torch.ones_like(k2), k2], -1)
    last = torch.arange(keys.shape[1], device=keys.device) == keys.shape[1] - 1
    return near_q, near_k.masked_fill(last[:, None], 0.0)


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

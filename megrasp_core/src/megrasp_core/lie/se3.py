"""Rigid motions: SE(3) as (..., 4, 4) homogeneous matrices, twists as (..., 6) = [v, w].

Translations in metres, rotations in radians. Batched over leading dimensions, differentiable.
"""

from __future__ import annotations

import torch
from torch import Tensor

from . import so3
from .precision import full_precision


def make(rotation: Tensor, translation: Tensor) -> Tensor:
    """Homogeneous matrices (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    shape = torch.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    top = torch.cat([rotation.expand(*shape, 3, 3), translation.expand(*shape, 3)[..., None]], -1)
    bottom = torch.zeros(4, dtype=top.dtype, device=top.device)
    bottom[3] = 1
    return torch.cat([top, bottom.expand(*shape, 1, 4)], -2)


@full_precision
def inverse(pose: Tensor) -> Tensor:
    """Inverse motions (..., 4, 4): b_from_a of a_from_b."""
    rotation = pose[..., :3, :3].transpose(-1, -2)
    return make(rotation, -(rotation @ pose[..., :3, 3:]).squeeze(-1))


def exp(xi: Tensor) -> Tensor:
    """Motions (..., 4, 4) of twists (..., 6) = [v, w]."""
    v, w = xi[..., :3], xi[..., 3:]
    _, b = so3.rodrigues_coefficients(w)
    c = so3.third_coefficient(w)
    cross = torch.linalg.cross(w, v, dim=-1)
    translation = v + b[..., None] * cross + c[..., None] * torch.linalg.cross(w, cross, dim=-1)
    return make(so3.exp(w), translation)


def log(pose: Tensor) -> Tensor:
    """Twists (..., 6) = [v, w] of motions (..., 4, 4); inverse of `exp` for angles up to pi."""
    w = so3.log(pose[..., :3, :3])
    t = pose[..., :3, 3]
    squared = (w * w).sum(-1)
    small = squared < 0.02
    angle = torch.where(small, 1.0, squared).sqrt()
    # (1 - (a/2) cot(a/2)) / a^2, which is 1/12 at the identity and 1/pi^2 at a half turn.
    exact = (1 - 0.5 * angle * (0.5 * angle).cos() / (0.5 * angle).sin()) / (angle * angle)
    series = (
        1 + squared / 60 * (1 + squared / 42 * (1 + squared / 40 * (1 + squared / 39.6)))
    ) / 12
    c = torch.where(small, series, exact)
    cross = torch.linalg.cross(w, t, dim=-1)
    v = t - 0.5 * cross + c[..., None] * torch.linalg.cross(w, cross, dim=-1)
    return torch.cat([v, w], -1)


@full_precision
def adjoint(pose: Tensor) -> Tensor:
    """Adjoint matrices (..., 6, 6): exp(adjoint(T) @ xi) = T exp(xi) T^-1, xi = [v, w]."""
    rotation, translation = pose[..., :3, :3], pose[..., :3, 3]
    top = torch.cat([rotation, so3.hat(translation) @ rotation], -1)
    bottom = torch.cat([torch.zeros_like(rotation), rotation], -1)
    return torch.cat([top, bottom], -2)


def from_pose7(pose: Tensor) -> Tensor:
    """Motions (..., 4, 4) of poses (..., 7) = [x, y, z, qx, qy, qz, qw]."""
    return make(so3.matrix_from_quat(pose[..., 3:]), pose[..., :3])


def to_pose7(pose: Tensor) -> Tensor:
    """Poses (..., 7) = [x, y, z, qx, qy, qz, qw] (qw >= 0) of motions (..., 4, 4)."""
    return torch.cat([pose[..., :3, 3], so3.quat_from_matrix(pose[..., :3, :3])], -1)

"""Rotations: SO(3) as (..., 3, 3) matrices and its Lie algebra as (..., 3) rotation vectors (rad).

Every function is batched over leading dimensions, keeps dtype and device of its input and has
finite gradients everywhere it is differentiable, the identity included.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .precision import full_precision

# Below this squared angle the closed forms lose digits and their derivatives become 0/0; the
# Taylor series to the order used is exact to float64 there.
_SMALL = 1e-4


def hat(w: Tensor) -> Tensor:
    """Skew matrices (..., 3, 3) of vectors (..., 3): ``hat(w) @ x == cross(w, x)``."""
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


def exp(w: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) (rad), by Rodrigues' formula."""
    a, b = rodrigues_coefficients(w)
    x, y, z = w.unbind(-1)
    # Written out by component: one fused stack is cheaper than batched 3x3 products, and it stays
    # out of reach of autocast.
    bx, by, bz = b * x, b * y, b * z
    ax, ay, az = a * x, a * y, a * z
    return torch.stack(
        [
            1 - (by * y + bz * z),
            bx * y - az,
            bx * z + ay,
            bx * y + az,
            1 - (bx * x + bz * z),
            by * z - ax,
            bx * z - ay,
            by * z + ax,
            1 - (bx * x + by * y),
        ],
        -1,
    ).unflatten(-1, (3, 3))


def rodrigues_coefficients(w: Tensor) -> tuple[Tensor, Tensor]:
    """sin(a)/a and (1 - cos a)/a^2 for a = |w|, w of shape (..., 3); each (...)."""
    squared = (w * w).sum(-1)
    small = squared < _SMALL
    safe = torch.where(small, 1.0, squared)
    angle = safe.sqrt()
    # 1 - cos a cancels at small angles; 2 sin^2(a/2) does not.
    first = torch.where(small, 1 - squared / 6 * (1 - squared / 20), angle.sin() / angle)
    second = torch.where(
        small, 0.5 - squared / 24 * (1 - squared / 30), 2 * (0.5 * angle).sin().square() / safe
    )
    return first, second


def log(r: Tensor) -> Tensor:
    """Rotation vectors (..., 3) (rad, norm at most pi) of rotation matrices (..., 3, 3).

    Goes through the quaternion, which is exact to rounding from the identity to half turns (where
    the sign of the axis is arbitrary). Gradients are finite at the identity.
    """
    q = quat_from_matrix(r)
    v, w = q[..., :3], q[..., 3]
    squared = (v * v).sum(-1)
    small = squared < _SMALL
    norm = torch.where(small, 1.0, squared).sqrt()
    safe_w = torch.where(small, w, 1.0)
    # 2 atan(x)/x over w with x = norm/w, whose square stays clear of the root.
    ratio = torch.where(small, squared, 0.0) / (safe_w * safe_w)
    series = 2 / safe_w * (1 - ratio * (1 / 3 - ratio * (1 / 5 - ratio / 7)))
    factor = torch.where(small, series, 2 * torch.atan2(norm, w) / norm)
    return factor[..., None] * v


def angle(r: Tensor) -> Tensor:
    """Rotation angles (...) in [0, pi] (rad) of rotation matrices (..., 3, 3)."""
    w = log(r)
    squared = (w * w).sum(-1)
    positive = squared > 0
    return torch.where(positive, torch.where(positive, squared, 1.0).sqrt(), 0.0)


def matrix_from_quat(q: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) as (x, y, z, w), any non-zero norm."""
    scaled = q * (2.0 / (q * q).sum(-1, keepdim=True))
    x, y, z, w = q.unbind(-1)
    sx, sy, sz, _ = scaled.unbind(-1)
    xx, xy, xz, xw = sx * x, sx * y, sx * z, sx * w
    yy, yz, yw = sy * y, sy * z, sy * w
    zz, zw = sz * z, sz * w
    return torch.stack(
        [
            1 - (yy + zz),
            xy - zw,
            xz + yw,
            xy + zw,
            1 - (xx + zz),
            yz - xw,
            xz - yw,
            yz + xw,
            1 - (xx + yy),
        ],
        -1,
    ).unflatten(-1, (3, 3))


def quat_from_matrix(r: Tensor) -> Tensor:
    """Unit quaternions (..., 4) as (x, y, z, w) with w >= 0 of rotation matrices (..., 3, 3).

    4 q q^T is linear in the matrix; its row with the largest diagonal element is a multiple of q
    with a norm of at least 2, so nothing is divided by a small number and no square root is taken
    near zero (finite gradients).
    """
    r00, r01, r02 = r[..., 0, 0], r[..., 0, 1], r[..., 0, 2]
    r10, r11, r12 = r[..., 1, 0], r[..., 1, 1], r[..., 1, 2]
    r20, r21, r22 = r[..., 2, 0], r[..., 2, 1], r[..., 2, 2]
    xy, xz, yz = r01 + r10, r02 + r20, r12 + r21
    xw, yw, zw = r21 - r12, r02 - r20, r10 - r01
    xx = 1 + r00 - r11 - r22
    yy = 1 - r00 + r11 - r22
    zz = 1 - r00 - r11 + r22
    ww = 1 + r00 + r11 + r22
    outer = torch.stack(
        [xx, xy, xz, xw, xy, yy, yz, yw, xz, yz, zz, zw, xw, yw, zw, ww], -1
    ).unflatten(-1, (4, 4))
    best = torch.stack([xx, yy, zz, ww], -1).argmax(-1)
    row = torch.take_along_dim(outer, best[..., None, None], -2).squeeze(-2)
    q = row / (row * row).sum(-1, keepdim=True).sqrt()
    return torch.where(q[..., 3:] < 0, -q, q)


@full_precision
def orthonormalize(r: Tensor) -> Tensor:
    """Rotations (..., 3, 3) nearest to almost-rotations: one Newton step of the polar form.

    The error of orthogonality e becomes about 3/4 e^2, so rounding does not build up over sampler
    steps. The step commutes with rotations from both sides, hence keeps equivariance. For matrices
    far from rotations (e over 0.1) it is not meant.
    """
    identity = torch.eye(3, dtype=r.dtype, device=r.device)
    return r @ (1.5 * identity - 0.5 * (r.transpose(-1, -2) @ r))


def random_rotation(
    *shape: int,
    generator: torch.Generator | None = None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Rotations (*shape, 3, 3) from the uniform (Haar) distribution."""
    q = torch.randn(*shape, 4, generator=generator, dtype=dtype, device=device)
    return matrix_from_quat(q)

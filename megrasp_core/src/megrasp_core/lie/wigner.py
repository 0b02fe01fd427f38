"""Wigner D matrices for l <= 2 without Euler angles, and rotation of steerable features.

Basis and order are e3nn's: for l = 1 the components are (x, y, z), so D1 = R; for l = 2 they are
(xz, xy, 2yy - xx - zz, yz, zz - xx), each scaled to unit norm. D2 = Q^T (R kron R) Q, where the
columns of Q are these five symmetric traceless matrices (e3nn's normalised `wigner_3j(1, 1, 2)`).
Polynomials in R, hence exact, batched and smooth at every pose. See docs/architecture.md,
"Network".
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError

MAX_L = 2

Block = tuple[int, int]
"""(multiplicity, l) of one block of an irreps string."""


@functools.cache
def l2_basis(dtype: torch.dtype, device: torch.device) -> Tensor:
    """Q (9, 5): orthonormal columns, row 3 i + j."""
    a, b = math.sqrt(1 / 2), math.sqrt(1 / 6)
    q = torch.zeros(3, 3, 5, dtype=torch.float64)
    q[0, 2, 0] = q[2, 0, 0] = a
    q[0, 1, 1] = q[1, 0, 1] = a
    q[0, 0, 2] = q[2, 2, 2] = -b
    q[1, 1, 2] = 2 * b
    q[1, 2, 3] = q[2, 1, 3] = a
    q[2, 2, 4], q[0, 0, 4] = a, -a
    return q.reshape(9, 5).to(dtype=dtype, device=device)


def wigner_d(degree: int, rotation: Tensor) -> Tensor:
    """Wigner D matrices (..., 2l+1, 2l+1) of rotations (..., 3, 3) for degree l = 0, 1, 2.

    Raises:
        InvalidRequestError: the degree is not 0, 1 or 2.
    """
    if degree == 0:
        return rotation.new_ones(*rotation.shape[:-2], 1, 1)
    if degree == 1:
        return rotation
    if degree != 2:
        raise InvalidRequestError(
            f"got degree l = {degree}; expected 0, 1 or 2, the degrees of Megrasp's features"
        )
    q = l2_basis(rotation.dtype, rotation.device)
    kron = rotation[..., :, None, :, None] * rotation[..., None, :, None, :]
    kron = kron.reshape(*rotation.shape[:-2], 9, 9)
    with torch.autocast(rotation.device.type, enabled=False):
        return q.T @ (kron @ q)


@functools.lru_cache(maxsize=256)
def _parse(text: str) -> tuple[Block, ...]:
    blocks = []
    for part in text.replace(" ", "").split("+"):
        match = re.fullmatch(r"(?:(\d+)x)?(\d+)[eo]", part)
        if match is None or int(match.group(2)) > MAX_L:
            raise InvalidRequestError(
                f"got irreps {text!r}; expected a sum such as '64x0e+32x1o+16x2e' with l at most 2"
            )
        blocks.append((int(match.group(1) or 1), int(match.group(2))))
    return tuple(blocks)


def blocks_of(irreps: object) -> tuple[Block, ...]:
    """Blocks (multiplicity, l) of irreps given as a string, an `e3nn.o3.Irreps` or such blocks.

    Parities are dropped: rotations do not see them.

    Raises:
        InvalidRequestError: the text is not an irreps string or holds l > 2.
    """
    if isinstance(irreps, tuple) and all(
        isinstance(b, tuple) and len(b) == 2 and isinstance(b[1], int) for b in irreps
    ):
        return irreps
    return _parse(str(irreps))


def irreps_dim(irreps: object) -> int:
    """Number of components of the irreps: sum of multiplicity times 2l+1."""
    return sum(mul * (2 * degree + 1) for mul, degree in blocks_of(irreps))


def rotate(
    features: Tensor,
    irreps: object,
    rotation: Tensor,
    matrices: Sequence[Tensor] | None = None,
) -> Tensor:
    """D(rotation) applied to steerable features, in e3nn's layout (block by block, mul-major).

    To bring scene features into the frame of a pose with rotation R, pass R transposed.

    Args:
        features: (*batch, *extra, dim); `batch` are the leading dimensions of `rotation`.
        irreps: for example "64x0e+32x1o+16x2e"; see `blocks_of`.
        rotation: (*batch, 3, 3).
        matrices: optional D matrices of `rotation` for l = 0, 1, 2 (see `wigner_matrices`), when
            several feature tensors are turned by the same rotations.

    Returns:
        (*batch, *extra, dim) in the dtype of `rotation`; never computed in a reduced autocast
        dtype.

    Raises:
        InvalidRequestError: the last dimension of `features` is not that of the irreps.
    """
    blocks = blocks_of(irreps)
    dim = irreps_dim(blocks)
    if features.shape[-1] != dim:
        raise InvalidRequestError(
            f"got features of shape {tuple(features.shape)}; expected {dim} in the last dimension "
            f"for irreps {irreps}"
        )
    batch = rotation.shape[:-2]
    if features.shape[: len(batch)] != batch:
        raise InvalidRequestError(
            f"got features of shape {tuple(features.shape)} for rotations of shape "
            f"{tuple(rotation.shape)}; expected the features to start with {tuple(batch)}"
        )
    x = features.to(rotation.dtype).reshape(*batch, -1, dim)
    outputs = []
    start = 0
    with torch.autocast(rotation.device.type, enabled=False):
        for mul, degree in blocks:
            width = mul * (2 * degree + 1)
            block = x[..., start : start + width]
            start += width
            if degree > 0 and mul > 0:
                d = matrices[degree] if matrices is not None else wigner_d(degree, rotation)
                block = _turn_block(block, d, mul)
            outputs.append(block)
    return torch.cat(outputs, -1).reshape(features.shape)


def _turn_block(block: Tensor, d: Tensor, mul: int) -> Tensor:
    """D on a block (*batch, rows, mul (2l+1)), mul-major, d (*batch, 2l+1, 2l+1)."""
    size = d.shape[-1]
    # Products with 3 or 5 columns starve the matrix kernels (measured 4 to 8 times slower on CPU):
    # turn several copies at once with a block-diagonal matrix.
    copies = math.gcd(mul, 8)
    eye = torch.eye(copies, dtype=d.dtype, device=d.device)
    wide = eye[:, None, :, None] * d.transpose(-1, -2)[..., None, :, None, :]
    wide = wide.reshape(*d.shape[:-2], copies * size, copies * size)
    rows = block.reshape(*block.shape[:-2], -1, copies * size)
    return (rows @ wide).reshape(block.shape)


def wigner_matrices(rotation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """D matrices of rotations (..., 3, 3) for l = 0, 1, 2, to share between calls of `rotate`."""
    return wigner_d(0, rotation), wigner_d(1, rotation), wigner_d(2, rotation)

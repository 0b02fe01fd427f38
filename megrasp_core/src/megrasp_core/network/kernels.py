"""Compiled kernels: optional twins of torch code in convolution and decoder.

Torch writes every product of an edge to memory and reads it again for the sum, and multiplies the
zeros of the coupling; here a message is added up where it is made, and zeros are left out. Needs
numba, `pip install 'megrasp-core[kernels]'`, no compiler; float32 on a CPU, one thread. The torch
code is the oracle.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from megrasp_core.errors import InvalidRequestError

Sizes = tuple[int, int, int, int, int]
"""Channels of the sources of degrees 0, 1, 2, and channels lifted to degrees 1 and 2."""


def require_kernels() -> None:
    """Raises InvalidRequestError where numba is missing."""
    if importlib.util.find_spec("numba") is None:
        raise InvalidRequestError(
            "compiled kernels were asked for and numba is not installed; expected it. Run `pip "
            "install 'megrasp-core[kernels]'`, or do without: training then takes longer."
        )


def can_compile(tensor: Tensor) -> bool:
    """Whether the kernels take it: float32 on a CPU."""
    return tensor.dtype == torch.float32 and tensor.device.type == "cpu"


def fused_messages(
    f0: Tensor,
    f1: Tensor | None,
    f2: Tensor | None,
    index: Tensor,
    weights: Tensor,
    y1: Tensor,
    y2: Tensor,
    sizes: Sizes,
) -> tuple[Tensor, Tensor, Tensor]:
    """Sums of the messages of `ReducedConvolution`, before the division by sqrt(k).

    Args:
        f0: features of the sources, `(N, c0)`;
        f1: `(N, 3, c1)`, None without channels;
        f2: `(N, 5, c2)`, None without channels.
        index: `(M, k)`.
        weights: `(M, k, w)` in the order of `ReducedConvolution`.
        y1: harmonics `(M, k, 3)` and
        y2: `(M, k, 5)`.
        sizes: channels.

    Returns:
        Degrees 0, 1, 2: `(M, c0 + c1 + c2)`, `(M, 3, c1 + l1)`, `(M, 5, c2 + l2)`.
    """
    n = len(f0)
    f1 = f0.new_zeros(n, 3, 0) if f1 is None else f1
    f2 = f0.new_zeros(n, 5, 0) if f2 is None else f2
    return _Messages.apply(f0, f1, f2, index, weights, y1, y2, sizes)  # type: ignore[return-value]


class _Messages(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, f0, f1, f2, index, weights, y1, y2, sizes):  # type: ignore[override]
        c0, c1, c2, l1, l2 = sizes
        tensors = [t.contiguous() for t in (f0, f1, f2, index, weights, y1, y2)]
        m = len(index)
        outs = (
            f0.new_zeros(m, c0 + c1 + c2),
            f0.new_zeros(m, 3, c1 + l1),
            f0.new_zeros(m, 5, c2 + l2),
        )
        forward, _ = _kernels(sizes)
        forward(*(t.detach().numpy() for t in (*tensors, *outs)))
        ctx.save_for_backward(*tensors)
        ctx.sizes = sizes
        return outs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor):  # type: ignore[override]
        f0, f1, f2, index, weights, y1, y2 = ctx.saved_tensors
        ours = [torch.zeros_like(t) for t in (f0, f1, f2)]
        of_weights = torch.empty_like(weights)
        _, backward = _kernels(ctx.sizes)
        tensors = (f0, f1, f2, index, weights, y1, y2, *(g.contiguous() for g in gradients))
        backward(*(t.detach().numpy() for t in (*tensors, *ours, of_weights)))
        return (*ours, None, of_weights, None, None, None)


@functools.lru_cache(maxsize=64)
def _kernels(sizes: Sizes) -> tuple[Callable[..., None], Callable[..., None]]:
    """Forward and backward for these numbers of channels, which are constants in the machine
    code: loops as short as these gain most from it.
    """
    import numba
    import numpy as np

    c0, c1, c2, l1, l2 = sizes
    norm1, norm2 = np.float32(3.0**-0.5), np.float32(5.0**-0.5)
    # Where the weights of each path begin: kept degrees, lifted, dropped.
    k1, k2 = c0, c0 + c1
    u1, u2 = c0 + c1 + c2, c0 + c1 + c2 + l1
    d1, d2 = u2 + l2, u2 + l2 + c1
    compiled = numba.njit(fastmath=True, nogil=True, boundscheck=False)

    @compiled
    def forward(f0, f1, f2, index, weights, y1, y2, o0, o1, o2):
        for m in range(index.shape[0]):
            for j in range(index.shape[1]):
                s = index[m, j]
                for c in range(c0):
                    o0[m, c] += f0[s, c] * weights[m, j, c]
                for i in range(3):
                    y = y1[m, j, i]
                    for c in range(c1):
                        x = f1[s, i, c]
                        o1[m, i, c] += x * weights[m, j, k1 + c]
                        o0[m, c0 + c] += norm1 * y * x * weights[m, j, d1 + c]
                    for c in range(l1):
                        o1[m, i, c1 + c] += y * f0[s, c] * weights[m, j, u1 + c]
                for i in range(5):
                    y = y2[m, j, i]
                    for c in range(c2):
                        x = f2[s, i, c]
                        o2[m, i, c] += x * weights[m, j, k2 + c]
                        o0[m, c0 + c1 + c] += norm2 * y * x * weights[m, j, d2 + c]
                    for c in range(l2):
                        o2[m, i, c2 + c] += y * f0[s, c] * weights[m, j, u2 + c]

    @compiled
    def backward(f0, f1, f2, index, weights, y1, y2, g0, g1, g2, a0, a1, a2, aw):
        for m in range(index.shape[0]):
            for j in range(index.shape[1]):
                s = index[m, j]
                for c in range(c0):
                    aw[m, j, c] = f0[s, c] * g0[m, c]
                    a0[s, c] += weights[m, j, c] * g0[m, c]
                for c in range(c1):
                    aw[m, j, k1 + c] = 0.0
                    aw[m, j, d1 + c] = 0.0
                for c in range(l1):
                    aw[m, j, u1 + c] = 0.0
                for i in range(3):
                    y = y1[m, j, i]
                    for c in range(c1):
                        keep, drop = g1[m, i, c], norm1 * y * g0[m, c0 + c]
                        aw[m, j, k1 + c] += f1[s, i, c] * keep
                        aw[m, j, d1 + c] += f1[s, i, c] * drop
                        a1[s, i, c] += weights[m, j, k1 + c] * keep + weights[m, j, d1 + c] * drop
                    for c in range(l1):
                        up = y * g1[m, i, c1 + c]
                        aw[m, j, u1 + c] += f0[s, c] * up
                        a0[s, c] += weights[m, j, u1 + c] * up
                for c in range(c2):
                    aw[m, j, k2 + c] = 0.0
                    aw[m, j, d2 + c] = 0.0
                for c in range(l2):
                    aw[m, j, u2 + c] = 0.0
                for i in range(5):
                    y = y2[m, j, i]
                    for c in range(c2):
                        keep, drop = g2[m, i, c], norm2 * y * g0[m, c0 + c1 + c]
                        aw[m, j, k2 + c] += f2[s, i, c] * keep
                        aw[m, j, d2 + c] += f2[s, i, c] * drop
                        a2[s, i, c] += weights[m, j, k2 + c] * keep + weights[m, j, d2 + c] * drop
                    for c in range(l2):
                        up = y * g2[m, i, c2 + c]
                        aw[m, j, u2 + c] += f0[s, c] * up
                        a0[s, c] += weights[m, j, u2 + c] * up

    return forward, backward


def sparse_product(left: Tensor, right: Tensor, coupling: Coupling) -> Tensor:
    """Channel-wise products `(N, K, c)`: sum of w left_i right_j over the entries (i, j, k, w).

    Args:
        left: `(N, D, c)`.
        right: `(N, D, c)`.
        coupling: the entries that are not zero.
    """
    return _Product.apply(left, right, coupling)  # type: ignore[return-value]


class Coupling:
    """A sparse tensor of three indices, with the kernels that are compiled for it.

    Args:
        dense: `(D, D, K)`.
    """

    def __init__(self, dense: Tensor) -> None:
        self.size = dense.shape[2]
        i, j, k = dense.nonzero(as_tuple=True)
        values = dense[i, j, k].tolist()
        self.entries = tuple(zip(i.tolist(), j.tolist(), k.tolist(), values, strict=True))


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, left, right, coupling):  # type: ignore[override]
        left, right = left.contiguous(), right.contiguous()
        out = left.new_zeros(len(left), coupling.size, left.shape[2])
        forward, _ = _product_kernels(coupling.entries, left.shape[2])
        forward(left.detach().numpy(), right.detach().numpy(), out.numpy())
        ctx.save_for_backward(left, right)
        ctx.coupling = coupling
        return out

    @staticmethod
    def backward(ctx: Any, gradient: Tensor):  # type: ignore[override]
        left, right = ctx.saved_tensors
        ours = torch.zeros_like(left), torch.zeros_like(right)
        _, backward = _product_kernels(ctx.coupling.entries, left.shape[2])
        tensors = (left, right, gradient.contiguous(), *ours)
        backward(*(t.detach().numpy() for t in tensors))
        return (*ours, None)


@functools.lru_cache(maxsize=64)
def _product_kernels(
    entries: tuple[tuple[int, int, int, float], ...], channels: int
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Forward and backward for these entries and so many channels."""
    import numba
    import numpy as np

    first, second, third = (np.array([e[n] for e in entries], np.int64) for n in range(3))
    value = np.array([e[3] for e in entries], np.float32)
    count = len(entries)
    compiled = numba.njit(fastmath=True, nogil=True, boundscheck=False)

    @compiled
    def forward(left, right, out):
        for n in range(left.shape[0]):
            for e in range(count):
                i, j, k, w = first[e], second[e], third[e], value[e]
                for c in range(channels):
                    out[n, k, c] += w * left[n, i, c] * right[n, j, c]

    @compiled
    def backward(left, right, g, a, b):
        for n in range(left.shape[0]):
            for e in range(count):
                i, j, k, w = first[e], second[e], third[e], value[e]
                for c in range(channels):
                    a[n, i, c] += w * g[n, k, c] * right[n, j, c]
                    b[n, j, c] += w * g[n, k, c] * left[n, i, c]

    return forward, backward


def nearest_points(points: Tensor, probes: Tensor, count: int) -> Tensor:
    """Indices `(P, count)` of the points `(n, 3)` nearest to any of the probes `(P, S, 3)` of a
    pose, in no order.
    """
    out = torch.empty(len(probes), count, dtype=torch.long)
    columns, probes = points.detach().T.contiguous(), probes.detach().contiguous()
    _nearest_kernel()(columns.numpy(), probes.numpy(), out.numpy())
    return out


@functools.lru_cache(maxsize=1)
def _nearest_kernel() -> Callable[..., None]:
    import numba
    import numpy as np

    @numba.njit(fastmath=True, nogil=True, boundscheck=False)
    def nearest(columns, probes, out):
        n, count = columns.shape[1], out.shape[1]
        least = np.empty(n, np.float32)
        for p in range(probes.shape[0]):
            for s in range(probes.shape[1]):
                x, y, z = probes[p, s, 0], probes[p, s, 1], probes[p, s, 2]
                for i in range(n):
                    a, b, c = columns[0, i] - x, columns[1, i] - y, columns[2, i] - z
                    d = a * a + b * b + c * c
                    least[i] = d if s == 0 else min(least[i], d)
            border = np.partition(least, count - 1)[count - 1]
            found = 0
            for i in range(n):
                if least[i] < border:
                    out[p, found] = i
                    found += 1
            for i in range(n):
                if found < count and least[i] == border:
                    out[p, found] = i
                    found += 1

    return nearest

"""Equivariant message passing with reduced paths, and the self-product that restores the others.

Per edge only l (x) 0 -> l, 0 (x) l -> l and l (x) l -> 0 are computed; each equals e3nn's
`TensorProduct` over the same paths (component normalisation), at about a seventh of the cost of
all paths. The full product over all natural-parity paths is taken once per node instead, where
there are 16 times fewer of them.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from megrasp_core.lie import coupling, spherical_harmonics

from .irreps import (
    EquivariantLinear,
    EquivariantNorm,
    Gate,
    Irreps,
    Steerable,
    multiplicities,
    scalars_of,
    sum_of,
)
from .kernels import Coupling, can_compile, fused_messages, sparse_product

SELF_PATHS = (
    (0, 0, 0), (1, 1, 0), (2, 2, 0),
    (0, 1, 1), (1, 0, 1), (1, 2, 1), (2, 1, 1),
    (0, 2, 2), (2, 0, 2), (1, 1, 2), (2, 2, 2),
)  # fmt: skip
"""The 11 paths (l1, l2, l3) of natural parity for l <= 2, ordered by l3."""


def harmonics(vectors: Tensor) -> dict[int, Tensor]:
    """Spherical harmonics of degree 1 and 2 of `(..., 3)` vectors, component normalised.

    A zero vector (a node that is its own neighbour) gives zeros, so that it adds nothing of
    higher degree.
    """
    length = vectors.norm(dim=-1, keepdim=True)
    unit = vectors / length.clamp_min(1e-9)
    alive = (length > 1e-7).to(vectors.dtype)
    return {degree: values * alive for degree, values in spherical_harmonics(unit).items()}


@dataclasses.dataclass(frozen=True)
class Edges:
    """The k neighbours of M targets among the sources.

    Attributes:
        index: `(M, k)` rows of the sources.
        basis: `(M, k, radial)` radial basis of the edges' lengths.
        harmonics: `{l: (M, k, 2l+1)}` for l = 1, 2, of the vectors from target to source.
    """

    index: Tensor
    basis: Tensor
    harmonics: dict[int, Tensor]


class RadialBasis(nn.Module):
    """Gaussians over [0, radius] of the edge length, times a smooth cut-off."""

    def __init__(self, count: int, radius: float) -> None:
        super().__init__()
        self.radius = radius
        self.centres: Tensor
        self.register_buffer("centres", torch.linspace(0.0, 1.0, count), persistent=False)
        self.count = count

    def forward(self, vectors: Tensor) -> Tensor:
        """`(..., 3)` m to `(..., count)`."""
        x = vectors.norm(dim=-1, keepdim=True) / self.radius
        waves = torch.exp(-0.5 * ((x - self.centres.to(x.dtype)) * self.count) ** 2)
        envelope = 0.5 * (1.0 + torch.cos(torch.pi * x.clamp(max=1.0)))
        return waves * (0.1 + envelope)


class ReducedConvolution(nn.Module):
    """Messages from the neighbours of each node over the reduced paths.

    Args:
        irreps: features of the sources; degree 2 may be missing. The messages have irreps
            `irreps_out`.
        lift: channels of degrees 1 and 2 that are made from scalars; by default as many as
            `irreps` has.
        radial: number of radial basis functions.
        hidden: width of the radial network.
    """

    def __init__(
        self,
        irreps: Irreps | str,
        radial: int,
        hidden: int,
        lift: tuple[int, int] | None = None,
    ) -> None:
        super().__init__()
        self.irreps_in = Irreps.of(irreps)
        mul = multiplicities(self.irreps_in)
        c0, c1, c2 = (mul.get(degree, 0) for degree in (0, 1, 2))
        l1, l2 = (c1, c2) if lift is None else lift
        if c0 < max(l1, l2):
            raise ValueError(f"irreps {irreps}: needs at least as many scalars as lifted vectors")
        self._lift = {1: l1, 2: l2}
        self._sizes = (c0, c1, c2, l1, l2)
        self.compiled = False
        """Use compiled kernels where they can be used."""
        self._split = (c0, c1, c2, l1, l2, c1, c2)
        """Channels that keep their degree (0, 1, 2), are lifted (1, 2), are dropped (1, 2)."""
        self.irreps_out = Irreps.of(f"{c0 + c1 + c2}x0e+{c1 + l1}x1o+{c2 + l2}x2e")
        self.radial = nn.Sequential(
            nn.Linear(radial, hidden), nn.SiLU(), nn.Linear(hidden, sum(self._split))
        )

    def __repr__(self) -> str:
        return f"ReducedConvolution({self.irreps_in} -> {self.irreps_out})"

    def forward(self, sources: Steerable, edges: Edges) -> Steerable:
        """Sum the messages over the neighbours.

        Args:
            sources: features of N sources.
            edges: M targets with k neighbours each.

        Returns:
            Features of the M targets, of `irreps_out`.
        """
        k = edges.index.shape[1]
        weights = self.radial(edges.basis)
        if self.compiled and can_compile(weights):
            out0, out1, out2 = fused_messages(
                scalars_of(sources),
                sources.get(1),
                sources.get(2),
                edges.index,
                weights,
                edges.harmonics[1],
                edges.harmonics[2],
                self._sizes,
            )
            return {0: out0.unsqueeze(-2) / k**0.5, 1: out1 / k**0.5, 2: out2 / k**0.5}
        w0, w11, w22, w01, w02, w10, w20 = weights.split(self._split, dim=-1)
        scalars = gathered(scalars_of(sources), edges.index)
        out0 = [(scalars * w0).sum(1)]
        out: Steerable = {}
        for degree, keep, lift, drop in ((1, w11, w01, w10), (2, w22, w02, w20)):
            y = edges.harmonics[degree]
            parts: list[Tensor] = []
            if keep.shape[-1]:
                part = gathered(sources[degree], edges.index)
                parts.append((part * keep.unsqueeze(-2)).sum(1))
                dots = (part * y.unsqueeze(-1)).sum(2) / (2 * degree + 1) ** 0.5
                out0.append((dots * drop).sum(1))
            lifted = y.transpose(1, 2) @ (scalars[..., : self._lift[degree]] * lift)
            out[degree] = torch.cat([*parts, lifted], -1) / k**0.5
        return {0: torch.cat(out0, -1).unsqueeze(-2) / k**0.5, **out}


def gathered(features: Tensor, index: Tensor) -> Tensor:
    """Rows `(M, k, ...)` of features `(N, ...)` at an index `(M, k)`."""
    return features.index_select(0, index.flatten()).view(*index.shape, *features.shape[1:])


class SelfProduct(nn.Module):
    """Channel-wise product of two mixed copies of a node's feature over all 11 natural-parity
    paths.
    """

    def __init__(self, irreps: Irreps | str) -> None:
        super().__init__()
        self.irreps_in = Irreps.of(irreps)
        self.channels = multiplicities(self.irreps_in)[2]
        c = self.channels
        common = f"{c}x0e+{c}x1o+{c}x2e"
        self.left = EquivariantLinear(irreps, common, bias=False)
        self.right = EquivariantLinear(irreps, common, bias=False)
        self.common = Irreps.of(common)
        self.irreps_out = Irreps.of(f"{3 * c}x0e+{4 * c}x1o+{4 * c}x2e")
        start = {0: 0, 1: 1, 2: 4}
        columns = []
        for l1, l2, l3 in SELF_PATHS:
            block = torch.zeros(9, 9, 2 * l3 + 1, dtype=torch.float64)
            cg = coupling(l1, l2, l3) * (2 * l3 + 1) ** 0.5
            rows, cols = 2 * l1 + 1, 2 * l2 + 1
            block[start[l1] : start[l1] + rows, start[l2] : start[l2] + cols] = cg
            columns.append(block.reshape(81, -1))
        self.coupling: Tensor
        self.register_buffer("coupling", torch.cat(columns, -1), persistent=False)
        self._sparse = Coupling(self.coupling.view(9, 9, -1))
        self.compiled = False
        """Use compiled kernels where they can be used."""

    def __repr__(self) -> str:
        return f"SelfProduct({self.irreps_in} -> {self.irreps_out})"

    def forward(self, features: Steerable) -> Steerable:
        """From `irreps_in` to `irreps_out`; channel c of path p is number `c * paths + p`."""
        left, right = (
            torch.cat(list(mix(features).values()), -2) for mix in (self.left, self.right)
        )
        if self.compiled and can_compile(left):
            product = sparse_product(left, right, self._sparse)
        else:
            left, right = (part.mT.reshape(-1, 9) for part in (left, right))
            outer = (left.unsqueeze(-1) * right.unsqueeze(-2)).flatten(-2)
            product = outer @ self.coupling.to(outer.dtype)
            product = product.view(len(features[0]), self.channels, -1).mT
        parts = product.split((3, 12, 20), dim=1)
        out: Steerable = {}
        for degree, (part, paths) in enumerate(zip(parts, (3, 4, 4), strict=True)):
            part = part.unflatten(1, (paths, 2 * degree + 1))
            out[degree] = part.permute(0, 2, 3, 1).flatten(-2)
        return out


class Block(nn.Module):
    """One step of the encoder: normalise, gather messages, mix, gate, add; then the self-product.

    Between levels the targets' own features may have another type (`irreps_target`), or be absent.
    """

    def __init__(
        self,
        irreps: Irreps | str,
        irreps_out: Irreps | str,
        *,
        irreps_target: Irreps | str | None,
        radial: int,
        hidden: int,
        lift: tuple[int, int] | None = None,
    ) -> None:
        super().__init__()
        self.irreps_out = Irreps.of(irreps_out)
        self.norm = EquivariantNorm(irreps)
        self.convolution = ReducedConvolution(irreps, radial, hidden, lift)
        self.gate = Gate(irreps_out)
        self.mix = EquivariantLinear(self.convolution.irreps_out, self.gate.irreps_in)
        self.own = (
            EquivariantLinear(irreps_target, irreps_out) if irreps_target is not None else None
        )
        self.norm_out = EquivariantNorm(irreps_out)
        self.product = SelfProduct(irreps_out)
        self.gate_out = Gate(irreps_out)
        self.mix_product = EquivariantLinear(self.product.irreps_out, self.gate_out.irreps_in)
        self.mix_out = EquivariantLinear(irreps_out, irreps_out)

    def forward(self, sources: Steerable, target: Steerable | None, edges: Edges) -> Steerable:
        """Features of the targets, of `irreps_out`."""
        message = self.convolution(self.norm(sources), edges)
        out = self.gate(self.mix(message))
        if self.own is not None and target is not None:
            out = sum_of(out, self.own(target))
        update = self.gate_out(self.mix_product(self.product(self.norm_out(out))))
        return sum_of(out, self.mix_out(update))

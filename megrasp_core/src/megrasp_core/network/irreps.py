"""Small equivariant layers.

Inside the network a feature of irreps `64x0e+32x1o+16x2e` is a `Steerable`: one tensor
`(..., 2l+1, mul)` per degree, components before channels, so that mixing channels is one matrix
product and nothing is cut out of or put back into a flat vector. `unpack` and `pack` convert from
and to e3nn's flat layout `(..., dim)`, channels before components, which is used at the borders.
Only natural parity (0e, 1o, 2e), each degree at most once and in this order, is used here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor, nn

Steerable = dict[int, Tensor]
"""Degree l -> `(..., 2l+1, mul)`, ascending degrees."""


@dataclass(frozen=True)
class Irreps:
    """The type of a feature: how many channels of each degree, written as e3nn does.

    Attributes:
        blocks: (channels, degree), ascending degrees.
    """

    blocks: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, irreps: Irreps | str) -> Irreps:
        """Read `64x0e+32x1o+16x2e`.

        Raises:
            ValueError: no such text, or another parity, order or degree than 0e, 1o, 2e.
        """
        if isinstance(irreps, Irreps):
            return irreps
        blocks: list[tuple[int, int]] = []
        for part in str(irreps).replace(" ", "").split("+"):
            match = re.fullmatch(r"(?:(\d+)x)?(0e|1o|2e)", part)
            degree = int(match[2][0]) if match else -1
            if match is None or (blocks and degree <= blocks[-1][1]):
                raise ValueError(
                    f"irreps {irreps}: expected at most 0e, 1o, 2e, once each, in this order"
                )
            blocks.append((int(match[1] or 1), degree))
        return cls(tuple(blocks))

    def __str__(self) -> str:
        return "+".join(f"{count}x{degree}{'eo'[degree % 2]}" for count, degree in self.blocks)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self.blocks)

    @property
    def dim(self) -> int:
        """Components of all channels together."""
        return sum(count * (2 * degree + 1) for count, degree in self.blocks)


def multiplicities(irreps: Irreps | str) -> dict[int, int]:
    """Number of channels per degree.

    Raises:
        ValueError: another parity, order or degree than 0e, 1o, 2e.
    """
    return {degree: count for count, degree in Irreps.of(irreps)}


def unpack(features: Tensor, irreps: Irreps | str) -> Steerable:
    """From e3nn's flat layout `(..., dim)`."""
    mul = multiplicities(irreps)
    # `split` and not slices: their gradients are zero-filled tensors of the whole size.
    parts = features.split([count * (2 * degree + 1) for degree, count in mul.items()], -1)
    return {
        degree: part.unflatten(-1, (count, 2 * degree + 1)).transpose(-1, -2)
        for (degree, count), part in zip(mul.items(), parts, strict=True)
    }


def pack(parts: Steerable) -> Tensor:
    """To e3nn's flat layout `(..., dim)`."""
    return torch.cat([parts[degree].transpose(-1, -2).flatten(-2) for degree in sorted(parts)], -1)


def scalars_of(features: Steerable) -> Tensor:
    """The invariant part `(..., mul)`."""
    return features[0].squeeze(-2)


def sum_of(left: Steerable, right: Steerable) -> Steerable:
    """Sum of two features of the same irreps."""
    return {degree: part + right[degree] for degree, part in left.items()}


class EquivariantLinear(nn.Module):
    """Mixes the channels of every degree by itself; bias on scalars only (e3nn `o3.Linear`)."""

    def __init__(
        self, irreps_in: Irreps | str, irreps_out: Irreps | str, bias: bool = True
    ) -> None:
        super().__init__()
        self.irreps_in, self.irreps_out = Irreps.of(irreps_in), Irreps.of(irreps_out)
        source, target = multiplicities(self.irreps_in), multiplicities(self.irreps_out)
        missing = [degree for degree in target if degree not in source]
        if missing:
            raise ValueError(f"degrees {missing} of {irreps_out} cannot be made from {irreps_in}")
        self._degrees = tuple(target)
        self.weights = nn.ParameterDict(
            {
                str(degree): nn.Parameter(torch.randn(source[degree], mul) / source[degree] ** 0.5)
                for degree, mul in target.items()
            }
        )
        self.bias = nn.Parameter(torch.zeros(target[0])) if bias and 0 in target else None

    def __repr__(self) -> str:
        return f"EquivariantLinear({self.irreps_in} -> {self.irreps_out})"

    def forward(self, features: Steerable) -> Steerable:
        """From `irreps_in` to `irreps_out`."""
        out = {degree: features[degree] @ self.weights[str(degree)] for degree in self._degrees}
        if self.bias is not None:
            out[0] = out[0] + self.bias
        return out


class EquivariantNorm(nn.Module):
    """Layer norm: scalars as usual, higher degrees divided by the root mean square of their
    norms.
    """

    def __init__(self, irreps: Irreps | str, eps: float = 1e-6) -> None:
        super().__init__()
        self.irreps_in = self.irreps_out = Irreps.of(irreps)
        self.eps = eps
        mul = multiplicities(self.irreps_in)
        self.scalar = nn.LayerNorm(mul[0])
        self.scales = nn.ParameterDict(
            {
                str(degree): nn.Parameter(torch.ones(count))
                for degree, count in mul.items()
                if degree
            }
        )

    def __repr__(self) -> str:
        return f"EquivariantNorm({self.irreps_in})"

    def forward(self, features: Steerable) -> Steerable:
        """Same irreps in and out."""
        out = {0: self.scalar(features[0])}
        for name, scale in self.scales.items():
            part = features[int(name)]
            mean_square = part.square().mean((-2, -1), keepdim=True)
            out[int(name)] = part * (torch.rsqrt(mean_square + self.eps) * scale)
        return out


class Gate(nn.Module):
    """SiLU on scalars; higher degrees multiplied by a sigmoid of own gate scalars.

    Takes `irreps_in` (= `irreps_out` with one more scalar for each channel of higher degree, in
    front).
    """

    def __init__(self, irreps: Irreps | str) -> None:
        super().__init__()
        self.irreps_out = Irreps.of(irreps)
        mul = multiplicities(self.irreps_out)
        self._sizes = [*(count for degree, count in mul.items() if degree), mul[0]]
        rest = ((count, degree) for degree, count in mul.items() if degree)
        self.irreps_in = Irreps(((sum(self._sizes), 0), *rest))

    def __repr__(self) -> str:
        return f"Gate({self.irreps_in} -> {self.irreps_out})"

    def forward(self, features: Steerable) -> Steerable:
        """From `irreps_in` to `irreps_out`."""
        *gates, scalars = features[0].split(self._sizes, -1)
        out = {0: nn.functional.silu(scalars)}
        higher = [degree for degree in features if degree]
        for degree, gate in zip(higher, gates, strict=True):
            out[degree] = features[degree] * torch.sigmoid(gate)
        return out

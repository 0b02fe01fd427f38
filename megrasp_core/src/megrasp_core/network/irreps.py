"""Small equivariant layers on e3nn's flat feature layout.

A feature of irreps `64x0e+32x1o+16x2e` is a flat vector `(..., dim)`, channel-major within one
degree, as in
e3nn. Only natural parity (0e, 1o, 2e), each degree at most once and in this order, is used here.
"""

from __future__ import annotations

from typing import cast

import torch
from e3nn.o3 import Irreps
from torch import Tensor, nn


def as_irreps(irreps: Irreps | str) -> Irreps:
    """Irreps of a text; e3nn's own constructor is typed too widely to be used directly."""
    return cast(Irreps, Irreps(irreps))


def multiplicities(irreps: Irreps | str) -> dict[int, int]:
    """Number of channels per degree.

    Raises:
        ValueError: another parity, order or degree than 0e, 1o, 2e.
    """
    found: dict[int, int] = {}
    for mul, ir in as_irreps(irreps):
        if ir.l > 2 or ir.p != (-1) ** ir.l or (found and ir.l <= max(found)):
            raise ValueError(
                f"irreps {irreps}: expected at most 0e, 1o, 2e, once each, in this order"
            )
        found[ir.l] = mul
    return found


def unpack(features: Tensor, irreps: Irreps | str) -> dict[int, Tensor]:
    """Split `(..., dim)` into `{l: (..., mul, 2l+1)}`."""
    out: dict[int, Tensor] = {}
    start = 0
    for degree, mul in multiplicities(irreps).items():
        size = mul * (2 * degree + 1)
        part = features[..., start : start + size]
        out[degree] = part.reshape(*part.shape[:-1], mul, 2 * degree + 1)
        start += size
    return out


def pack(parts: dict[int, Tensor]) -> Tensor:
    """Inverse of `unpack`."""
    return torch.cat([parts[degree].flatten(-2) for degree in sorted(parts)], dim=-1)


class EquivariantLinear(nn.Module):
    """Mixes the channels of every degree by itself; bias on scalars only (e3nn `o3.Linear`)."""

    def __init__(
        self, irreps_in: Irreps | str, irreps_out: Irreps | str, bias: bool = True
    ) -> None:
        super().__init__()
        self.irreps_in, self.irreps_out = as_irreps(irreps_in), as_irreps(irreps_out)
        source, target = multiplicities(self.irreps_in), multiplicities(self.irreps_out)
        self._target = target
        self.weights = nn.ParameterDict(
            {
                str(degree): nn.Parameter(torch.randn(source[degree], mul) / source[degree] ** 0.5)
                for degree, mul in target.items()
                if degree in source
            }
        )
        missing = [degree for degree in target if degree not in source]
        if missing:
            raise ValueError(f"degrees {missing} of {irreps_out} cannot be made from {irreps_in}")
        self.bias = nn.Parameter(torch.zeros(target[0])) if bias and 0 in target else None

    def __repr__(self) -> str:
        return f"EquivariantLinear({self.irreps_in} -> {self.irreps_out})"

    def forward(self, features: Tensor) -> Tensor:
        """`(..., dim_in)` to `(..., dim_out)`."""
        parts = unpack(features, self.irreps_in)
        out: list[Tensor] = []
        for degree in self._target:
            weight = self.weights[str(degree)]
            if degree == 0:
                value = parts[0].squeeze(-1) @ weight
                out.append(value if self.bias is None else value + self.bias)
            else:
                mixed = torch.einsum("...cm,cd->...dm", parts[degree], weight)
                out.append(mixed.flatten(-2))
        return torch.cat(out, dim=-1)


class EquivariantNorm(nn.Module):
    """Layer norm: scalars as usual, higher degrees divided by the root mean square of their
    norms.
    """

    def __init__(self, irreps: Irreps | str, eps: float = 1e-6) -> None:
        super().__init__()
        self.irreps = as_irreps(irreps)
        self.eps = eps
        self._mul = multiplicities(self.irreps)
        self.scalar = nn.LayerNorm(self._mul[0])
        self.scales = nn.ParameterDict(
            {
                str(degree): nn.Parameter(torch.ones(mul))
                for degree, mul in self._mul.items()
                if degree
            }
        )

    def __repr__(self) -> str:
        return f"EquivariantNorm({self.irreps})"

    def forward(self, features: Tensor) -> Tensor:
        """`(..., dim)` to `(..., dim)`."""
        parts = unpack(features, self.irreps)
        out = {0: self.scalar(parts[0].squeeze(-1)).unsqueeze(-1)}
        for degree, scale in self.scales.items():
            part = parts[int(degree)]
            mean_square = part.square().sum(-1).mean(-1) / part.shape[-1]
            part = part * torch.rsqrt(mean_square + self.eps)[..., None, None]
            out[int(degree)] = part * scale[:, None]
        return pack(out)


class Gate(nn.Module):
    """SiLU on scalars; higher degrees multiplied by a sigmoid of own gate scalars.

    Takes `irreps_in` (= `irreps` with one more scalar for each channel of higher degree, in
    front).
    """

    def __init__(self, irreps: Irreps | str) -> None:
        super().__init__()
        self.irreps = as_irreps(irreps)
        self._mul = multiplicities(self.irreps)
        self.gates = sum(mul for degree, mul in self._mul.items() if degree)
        scalars = self._mul[0] + self.gates
        rest = [(mul, (degree, (-1) ** degree)) for degree, mul in self._mul.items() if degree]
        self.irreps_in = cast(Irreps, Irreps([(scalars, (0, 1)), *rest]))

    def __repr__(self) -> str:
        return f"Gate({self.irreps_in} -> {self.irreps})"

    def forward(self, features: Tensor) -> Tensor:
        """`(..., dim_in)` to `(..., dim)`."""
        gates = torch.sigmoid(features[..., : self.gates])
        parts = unpack(features[..., self.gates :], self.irreps)
        out = {0: nn.functional.silu(parts[0])}
        start = 0
        for degree, mul in self._mul.items():
            if degree:
                out[degree] = parts[degree] * gates[..., start : start + mul, None]
                start += mul
        return pack(out)

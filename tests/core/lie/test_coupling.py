"""Couplings and spherical harmonics against e3nn's."""

from __future__ import annotations

import itertools

import pytest
import torch
from e3nn import o3

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import coupling, spherical_harmonics

F64 = torch.float64


def couples(degrees: tuple[int, int, int]) -> bool:
    return sum(degrees) % 2 == 0 and 2 * max(degrees) <= sum(degrees)


@pytest.mark.parametrize("degrees", filter(couples, itertools.product(range(3), repeat=3)))
def test_couplings_are_e3nns(degrees: tuple[int, int, int]) -> None:
    mine, theirs = coupling(*degrees), o3.wigner_3j(*degrees, dtype=F64)
    torch.testing.assert_close(mine, theirs, rtol=0, atol=1e-14)
    # The sparse kernels skip zeros: what is next to nothing must be nothing.
    assert torch.equal(mine != 0, theirs.abs() > 1e-9)


@pytest.mark.parametrize("degrees", [(1, 1, 1), (0, 1, 2), (2, 2, 1), (3, 3, 0), (-1, 1, 0)])
def test_what_does_not_couple_is_refused(degrees: tuple[int, int, int]) -> None:
    with pytest.raises(InvalidRequestError, match="expected three of 0, 1, 2"):
        coupling(*degrees)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_spherical_harmonics_are_e3nns(dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(3)
    vectors = torch.randn(50, 7, 3, dtype=dtype, generator=generator)
    unit = torch.nn.functional.normalize(vectors, dim=-1)
    mine = spherical_harmonics(unit)
    for degree in (1, 2):
        theirs = o3.spherical_harmonics(degree, unit, normalize=False, normalization="component")
        torch.testing.assert_close(mine[degree], theirs, rtol=1e-6, atol=1e-6)

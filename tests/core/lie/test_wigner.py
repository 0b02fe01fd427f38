"""Wigner D matrices: homomorphism, e3nn as the oracle, gradients, feature rotation."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
import torch
from e3nn import o3
from hypothesis import given, settings
from hypothesis import strategies as st

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import irreps_dim, rotate, so3, wigner_d, wigner_matrices
from megrasp_core.lie.wigner import l2_basis

WIDE = "64x0e+32x1o+16x2e"


@pytest.fixture
def double() -> Iterator[None]:
    """E3nn builds its constants in the default dtype."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)


def _rotations(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return so3.random_rotation(count, generator=generator, dtype=torch.float64)


def _special() -> torch.Tensor:
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    yaws = [0.0, 1e-9, 1e-4, 0.5, math.pi / 2, math.pi, -2.5]
    turns = so3.exp(torch.tensor([[0, 0, yaw] for yaw in yaws], dtype=torch.float64))
    return torch.cat([torch.eye(3, dtype=torch.float64)[None], turns, turns @ down])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_homomorphism(seed: int) -> None:
    a, b = _rotations(2, seed)
    for degree in range(3):
        d = wigner_d(degree, a) @ wigner_d(degree, b)
        torch.testing.assert_close(wigner_d(degree, a @ b), d, rtol=0, atol=1e-14)
        identity = torch.eye(2 * degree + 1, dtype=torch.float64)
        torch.testing.assert_close(
            wigner_d(degree, a) @ wigner_d(degree, a).T, identity, rtol=0, atol=1e-14
        )
    assert torch.equal(wigner_d(1, a), a)


def test_basis_is_e3nns_wigner_3j(double: None) -> None:
    q = math.sqrt(5) * o3.wigner_3j(1, 1, 2).reshape(9, 5)
    torch.testing.assert_close(l2_basis(torch.float64, torch.device("cpu")), q, rtol=0, atol=1e-14)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_equals_e3nn(double: None, degree: int) -> None:
    r = _rotations(200)
    parity = "o" if degree % 2 else "e"
    expected = o3.Irrep(f"{degree}{parity}").D_from_matrix(r)
    torch.testing.assert_close(wigner_d(degree, r), expected, rtol=0, atol=1e-12)


def test_turns_spherical_harmonics_also_at_special_poses(double: None) -> None:
    generator = torch.Generator().manual_seed(5)
    x = torch.randn(30, 3, generator=generator)
    harmonics = o3.Irreps("1x0e+1x1o+1x2e")
    y = o3.spherical_harmonics(harmonics, x, normalize=True)
    for r in torch.cat([_special(), _rotations(20)]):
        turned = o3.spherical_harmonics(harmonics, x @ r.T, normalize=True)
        torch.testing.assert_close(rotate(y, harmonics, r), turned, rtol=0, atol=1e-14)


def test_gradients_are_finite_and_exact_at_special_poses() -> None:
    for base in _special():
        w = torch.zeros(3, dtype=torch.float64, requires_grad=True)

        def matrix(x: torch.Tensor, base: torch.Tensor = base) -> torch.Tensor:
            return wigner_d(2, base @ so3.exp(x))

        jacobian = torch.autograd.functional.jacobian(matrix, w)
        assert isinstance(jacobian, torch.Tensor) and torch.isfinite(jacobian).all()
        assert torch.autograd.gradcheck(matrix, (w,))


@pytest.mark.parametrize("irreps", [WIDE, "32x0e+16x1o+8x2e", "3x1o+1x0e+5x2e", "2e", "7x0e"])
def test_rotate_equals_e3nn_layout(double: None, irreps: str) -> None:
    r = _rotations(6)
    whole = o3.Irreps(irreps)
    generator = torch.Generator().manual_seed(7)
    x = torch.randn(6, 4, 2, whole.dim, generator=generator)
    expected = torch.einsum("pij,pabj->pabi", whole.D_from_matrix(r), x)
    torch.testing.assert_close(rotate(x, irreps, r), expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(rotate(x, whole, r, wigner_matrices(r)), rotate(x, irreps, r))
    back = rotate(rotate(x, irreps, r), irreps, r.mT)
    torch.testing.assert_close(back, x, rtol=0, atol=1e-13)
    assert irreps_dim(irreps) == whole.dim


def test_rotate_is_differentiable() -> None:
    x = torch.randn(2, 3, 17, dtype=torch.float64, requires_grad=True)
    w = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)

    def turned(f: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return rotate(f, "3x0e+3x1o+1x2e", so3.exp(v))

    assert torch.autograd.gradcheck(turned, (x, w))


def test_rotate_stays_in_full_precision_under_autocast() -> None:
    r = _rotations(5).float()
    x = torch.randn(5, 3, 240)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        turned = rotate(x, WIDE, r)
        assert turned.dtype == torch.float32
        assert rotate(x.bfloat16(), WIDE, r).dtype == torch.float32
    torch.testing.assert_close(turned, rotate(x, WIDE, r), rtol=0, atol=0)


def test_bad_input_is_named() -> None:
    r = torch.eye(3)
    with pytest.raises(InvalidRequestError, match="degree"):
        wigner_d(3, r)
    with pytest.raises(InvalidRequestError, match="irreps"):
        rotate(torch.zeros(4), "1x3o", r)
    with pytest.raises(InvalidRequestError, match="240"):
        rotate(torch.zeros(5, 239), WIDE, r.expand(5, 3, 3))
    with pytest.raises(InvalidRequestError, match="start with"):
        rotate(torch.zeros(4, 240), WIDE, r.expand(5, 3, 3))

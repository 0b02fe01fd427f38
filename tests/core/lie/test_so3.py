"""Rotations: group axioms, exp and log, quaternions, gradients."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from megrasp_core.lie import so3

unit = st.floats(-1, 1, allow_nan=False)
quick = settings(max_examples=60, deadline=None)


@st.composite
def rotation_vectors(draw: st.DrawFn, low: float = 0.0, high: float = math.pi) -> torch.Tensor:
    axis = torch.tensor([draw(unit) for _ in range(3)], dtype=torch.float64)
    if axis.norm() < 1e-3:
        axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    exponent = draw(st.floats(0, 1))
    # Also spread over small scales: angles down to 1e-12 of the range.
    scale = draw(st.sampled_from([1.0, 1e-2, 1e-4, 1e-8, 1e-12]))
    return axis / axis.norm() * (low + (high - low) * exponent * scale)


@quick
@given(rotation_vectors(), rotation_vectors(), rotation_vectors())
def test_group_axioms(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> None:
    ra, rb, rc = so3.exp(a), so3.exp(b), so3.exp(c)
    identity = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close((ra @ rb) @ rc, ra @ (rb @ rc), rtol=0, atol=1e-14)
    torch.testing.assert_close(ra @ so3.exp(-a), identity, rtol=0, atol=1e-14)
    product = ra @ rb
    torch.testing.assert_close(product @ product.T, identity, rtol=0, atol=1e-14)
    assert torch.linalg.det(product) == pytest.approx(1, abs=1e-13)


@quick
@given(rotation_vectors(high=math.pi - 1e-7))
def test_log_inverts_exp(w: torch.Tensor) -> None:
    back = so3.log(so3.exp(w))
    # Rounding of the matrix is 1e-16, of its angle the same: absolute, not relative.
    torch.testing.assert_close(back, w, rtol=1e-12, atol=5e-16 if w.norm() < 1e-3 else 1e-14)


@quick
@given(rotation_vectors())
@example(torch.tensor([0.0, 0.0, 5.3575e-158], dtype=torch.float64))
def test_exp_inverts_log_up_to_half_turns(w: torch.Tensor) -> None:
    # Squares of the smallest numbers lose all digits, and the axis its length: scale first.
    largest = w.abs().max()
    axis = w / largest if largest > 0 else torch.tensor([1.0, 0, 0], dtype=torch.float64)
    direction = axis / axis.norm()
    for angle in (float(w.norm()), math.pi, math.pi - 1e-9, math.pi - 1e-5):
        r = so3.exp(angle * direction)
        v = so3.log(r)
        assert v.norm() <= math.pi + 1e-12
        torch.testing.assert_close(so3.exp(v), r, rtol=0, atol=1e-14)
        assert so3.angle(r) == pytest.approx(angle, abs=1e-12)


@pytest.mark.parametrize("dtype,tolerance", [(torch.float32, 3e-6), (torch.float64, 1e-14)])
def test_round_trips_in_batches(dtype: torch.dtype, tolerance: float) -> None:
    generator = torch.Generator().manual_seed(0)
    r = so3.random_rotation(7, 300, generator=generator, dtype=dtype)
    assert r.shape == (7, 300, 3, 3)
    torch.testing.assert_close(so3.exp(so3.log(r)), r, rtol=0, atol=tolerance)
    q = so3.quat_from_matrix(r)
    assert (q[..., 3] >= 0).all()
    torch.testing.assert_close(q.norm(dim=-1), torch.ones_like(q[..., 0]), rtol=0, atol=tolerance)
    torch.testing.assert_close(so3.matrix_from_quat(q), r, rtol=0, atol=tolerance)
    torch.testing.assert_close(so3.matrix_from_quat(-3 * q), r, rtol=0, atol=tolerance)


def test_hat_vee_and_exp_against_matrix_exponential() -> None:
    generator = torch.Generator().manual_seed(1)
    w = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    x = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    product = (so3.hat(w) @ x[..., None]).squeeze(-1)
    torch.testing.assert_close(product, torch.linalg.cross(w, x))
    expected = torch.linalg.matrix_exp(so3.hat(w))
    torch.testing.assert_close(so3.exp(w), expected, rtol=0, atol=1e-13)


def test_quaternion_order_is_xyzw() -> None:
    quarter_z = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    half = math.sqrt(0.5)
    torch.testing.assert_close(so3.quat_from_matrix(quarter_z), torch.tensor([0, 0, half, half]))
    torch.testing.assert_close(so3.exp(torch.tensor([0, 0, math.pi / 2])), quarter_z)


def _top_down(yaw: float) -> torch.Tensor:
    down = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    return so3.exp(torch.tensor([0, 0, yaw], dtype=torch.float64)) @ down


def test_gradients_at_the_identity_are_exact() -> None:
    w = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    jacobian = torch.autograd.functional.jacobian(lambda x: so3.exp(x), w)
    basis = so3.hat(torch.eye(3, dtype=torch.float64)).permute(1, 2, 0)
    torch.testing.assert_close(jacobian, basis, rtol=0, atol=1e-15)
    through = torch.autograd.functional.jacobian(lambda x: so3.log(so3.exp(x)), w)
    torch.testing.assert_close(through, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-15)


@pytest.mark.parametrize("yaw", [0.0, 1e-8, 0.3, math.pi / 2, math.pi, -2.0])
def test_gradients_are_finite_at_top_down_poses(yaw: float) -> None:
    for base in (_top_down(yaw), so3.exp(torch.tensor([0, 0, yaw], dtype=torch.float64))):
        r = base.clone().requires_grad_()
        (so3.log(r).sum() + so3.quat_from_matrix(r).sum() + so3.angle(r)).backward()
        assert r.grad is not None and torch.isfinite(r.grad).all()


def test_log_gradient_near_top_down_matches_differences() -> None:
    base = _top_down(0.7) @ so3.exp(torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    w = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: so3.log(base @ so3.exp(x)), (w,))
    assert torch.autograd.gradcheck(lambda x: so3.angle(base @ so3.exp(x)), (w,))


def test_orthonormalize_keeps_long_products_on_the_group() -> None:
    generator = torch.Generator().manual_seed(2)
    step = so3.random_rotation(64, generator=generator)
    kept = free = so3.random_rotation(64, generator=generator)
    identity = torch.eye(3)
    for _ in range(2000):
        kept = so3.orthonormalize(kept @ step)
        free = free @ step
    error = (kept.mT @ kept - identity).abs().max()
    drift = (free.mT @ free - identity).abs().max()
    assert error < 1e-6 < drift
    noisy = kept + 1e-3 * torch.randn(64, 3, 3, generator=generator)
    assert (so3.orthonormalize(noisy).mT @ so3.orthonormalize(noisy) - identity).abs().max() < 1e-4


def test_random_rotations_are_uniform() -> None:
    generator = torch.Generator().manual_seed(3)
    r = so3.random_rotation(20000, generator=generator, dtype=torch.float64)
    # Haar: zero mean, second moments 1/3, angle density (1 - cos w)/pi with mean pi/2 + 2/pi.
    assert r.mean(0).abs().max() < 0.02
    torch.testing.assert_close(
        (r * r).mean(0), torch.full((3, 3), 1 / 3, dtype=torch.float64), rtol=0, atol=0.01
    )
    assert so3.angle(r).mean() == pytest.approx(math.pi / 2 + 2 / math.pi, abs=0.02)
    again = so3.random_rotation(
        20000, generator=torch.Generator().manual_seed(3), dtype=torch.float64
    )
    assert torch.equal(r, again)

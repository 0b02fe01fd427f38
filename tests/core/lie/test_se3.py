"""Rigid motions: axioms, exp and log, adjoint, poses at file borders."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix, se3, so3

quick = settings(max_examples=60, deadline=None)


@st.composite
def twists(draw: st.DrawFn) -> torch.Tensor:
    parts = [draw(st.floats(-1, 1)) for _ in range(6)]
    xi = torch.tensor(parts, dtype=torch.float64)
    angle = xi[3:].norm()
    largest = math.pi - 1e-6
    wanted = draw(st.sampled_from([1e-12, 1e-8, 1e-5, 1e-3, 0.1, 0.15, 1.0, 3.0, largest]))
    if angle > 1e-3:
        xi[3:] *= wanted / angle
    return xi


@quick
@given(twists())
def test_exp_and_log(xi: torch.Tensor) -> None:
    generator = torch.zeros(4, 4, dtype=torch.float64)
    generator[:3, :3], generator[:3, 3] = so3.hat(xi[3:]), xi[:3]
    pose = se3.exp(xi)
    torch.testing.assert_close(pose, torch.linalg.matrix_exp(generator), rtol=0, atol=1e-13)
    torch.testing.assert_close(se3.log(pose), xi, rtol=1e-9, atol=1e-12)


@quick
@given(twists(), twists(), twists())
def test_group_axioms(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> None:
    ta, tb, tc = se3.exp(a), se3.exp(b), se3.exp(c)
    torch.testing.assert_close((ta @ tb) @ tc, ta @ (tb @ tc), rtol=0, atol=1e-13)
    identity = torch.eye(4, dtype=torch.float64)
    torch.testing.assert_close(se3.inverse(ta) @ ta, identity, rtol=0, atol=1e-13)
    torch.testing.assert_close(
        se3.inverse(ta @ tb), se3.inverse(tb) @ se3.inverse(ta), rtol=0, atol=1e-13
    )


@quick
@given(twists(), twists())
def test_adjoint_moves_twists(a: torch.Tensor, b: torch.Tensor) -> None:
    pose, small = se3.exp(a), 0.3 * b
    moved = se3.exp(se3.adjoint(pose) @ small)
    torch.testing.assert_close(
        moved, pose @ se3.exp(small) @ se3.inverse(pose), atol=1e-12, rtol=0
    )


def test_gradients_at_the_identity() -> None:
    xi = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    through = torch.autograd.functional.jacobian(lambda x: se3.log(se3.exp(x)), xi)
    torch.testing.assert_close(through, torch.eye(6, dtype=torch.float64), rtol=0, atol=1e-14)


def test_float32_translation_keeps_its_digits_at_every_angle() -> None:
    generator = torch.Generator().manual_seed(0)
    axis = torch.nn.functional.normalize(torch.randn(400, 3, generator=generator), dim=-1)
    angle = torch.logspace(-6, math.log10(3.1), 400)[:, None]
    xi = torch.cat([torch.randn(400, 3, generator=generator), axis * angle], -1)
    exact = se3.exp(xi.double())
    torch.testing.assert_close(se3.exp(xi).double(), exact, rtol=0, atol=2e-6)
    torch.testing.assert_close(se3.log(se3.exp(xi)).double(), xi.double(), rtol=0, atol=1e-5)


def test_pose7_in_torch_and_numpy_agree() -> None:
    generator = torch.Generator().manual_seed(1)
    rotation = so3.random_rotation(4, 5, generator=generator, dtype=torch.float64)
    pose = se3.make(rotation, torch.randn(4, 5, 3, generator=generator, dtype=torch.float64))
    seven = se3.to_pose7(pose)
    assert seven.shape == (4, 5, 7)
    np.testing.assert_allclose(pose7_from_matrix(pose.numpy()), seven.numpy(), atol=1e-12)
    np.testing.assert_allclose(matrix_from_pose7(seven.numpy()), pose.numpy(), atol=1e-12)
    torch.testing.assert_close(se3.from_pose7(seven), pose, rtol=0, atol=1e-12)


def test_numpy_poses_of_any_batch_shape() -> None:
    assert matrix_from_pose7([1, 2, 3, 0, 0, 0, 2]).tolist() == [
        [1, 0, 0, 1],
        [0, 1, 0, 2],
        [0, 0, 1, 3],
        [0, 0, 0, 1],
    ]
    assert matrix_from_pose7(np.zeros((0, 7))).shape == (0, 4, 4)
    assert pose7_from_matrix(np.zeros((0, 4, 4))).shape == (0, 7)


@pytest.mark.parametrize(
    "bad", [np.zeros(6), np.zeros(7), np.full((2, 7), np.nan), [0, 0, 0, 1, 0, 0, np.inf]]
)
def test_bad_poses_are_named(bad: object) -> None:
    with pytest.raises(InvalidRequestError, match="expected"):
        matrix_from_pose7(bad)  # pyright: ignore[reportArgumentType]


def test_bad_matrices_are_named() -> None:
    with pytest.raises(InvalidRequestError, match="expected"):
        pose7_from_matrix(np.eye(3))

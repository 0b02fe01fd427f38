"""The equivariance check itself: it passes what is equivariant and catches what is not."""

from __future__ import annotations

import pytest
import torch

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import so3
from megrasp_core.network.testing import assert_equivariant, equivariance_report, move

F64 = torch.float64


def _inputs(dtype: torch.dtype = F64) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    points = torch.randn(20, 3, generator=generator, dtype=dtype)
    features = torch.randn(20, 15, generator=generator, dtype=dtype)
    rotation = so3.random_rotation(20, generator=generator, dtype=dtype)
    return points, features, rotation


KINDS = ("point", "2x0e+1x1o+2x2e", "rotation")


def _good(points: torch.Tensor, features: torch.Tensor, rotation: torch.Tensor):
    centre = points.mean(0)
    offset = points - centre
    local = (rotation.mT @ offset[..., None]).squeeze(-1)
    return centre, features * offset.norm(dim=-1, keepdim=True), local, offset


OUT = ("point", "2x0e+1x1o+2x2e", "invariant", "vector")


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_equivariant_function_passes(dtype: torch.dtype) -> None:
    cases = assert_equivariant(_good, _inputs(dtype), KINDS, OUT, trials=4)
    assert len(cases) == (6 + 4) * 4
    assert len({case.motion for case in cases}) == 10
    if dtype == F64:
        assert max(case.error for case in cases) < 1e-13


def test_failures_are_reported_case_by_case() -> None:
    def bad(points: torch.Tensor, features: torch.Tensor, rotation: torch.Tensor):
        centre, turned, local, offset = _good(points, features, rotation)
        return centre, turned, local + 1e-3 * points[:, :1], offset

    with pytest.raises(AssertionError, match=r"FAIL translation .*output 2 \(invariant\)") as info:
        assert_equivariant(bad, _inputs(), KINDS, OUT)
    assert "FAIL identity" not in str(info.value) and "ok   identity" in str(info.value)


def test_swapped_components_and_nan_are_caught() -> None:
    def swapped(points: torch.Tensor, features: torch.Tensor, rotation: torch.Tensor):
        return features[:, [0, 1, 3, 4, 2, *range(5, 15)]]

    def broken(points: torch.Tensor, features: torch.Tensor, rotation: torch.Tensor):
        return features * float("nan")

    for function in (swapped, broken):
        with pytest.raises(AssertionError, match="not equivariant"):
            assert_equivariant(function, _inputs(), KINDS, KINDS[1:2])
    cases = equivariance_report(swapped, _inputs(), KINDS, KINDS[1:2])
    assert any(not case.passed for case in cases)


def test_poses_move_and_counts_are_checked() -> None:
    pose = torch.eye(4, dtype=F64).repeat(3, 1, 1)
    pose[:, :3, 3] = torch.tensor([1.0, 2, 3], dtype=F64)
    q, u = so3.random_rotation(dtype=F64), torch.tensor([0.1, 0.2, 0.3], dtype=F64)
    moved = move(pose, "pose", q, u)
    torch.testing.assert_close(moved[0, :3, :3], q)
    torch.testing.assert_close(moved[0, :3, 3], q @ pose[0, :3, 3] + u)
    with pytest.raises(InvalidRequestError, match="kinds"):
        assert_equivariant(lambda x: x, (pose,), (), ("pose",))
    with pytest.raises(InvalidRequestError, match="outputs"):
        assert_equivariant(lambda x: x, (pose,), ("pose",), ("pose", "pose"))

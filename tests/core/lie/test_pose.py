"""Poses at file borders, in numpy and as batches of tensors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from megrasp_core.errors import InvalidRequestError
from megrasp_core.lie import PoseBatch, matrix_from_pose7, pose7_from_matrix, so3


def test_seven_numbers_agree_with_torch() -> None:
    generator = torch.Generator().manual_seed(1)
    rotation = so3.random_rotation(4, 5, generator=generator, dtype=torch.float64)
    place = torch.randn(4, 5, 3, generator=generator, dtype=torch.float64)
    matrix = np.tile(np.eye(4), (4, 5, 1, 1))
    matrix[..., :3, :3], matrix[..., :3, 3] = rotation, place
    seven = torch.cat([place, so3.quat_from_matrix(rotation)], -1).numpy()
    np.testing.assert_allclose(pose7_from_matrix(matrix), seven, atol=1e-12)
    np.testing.assert_allclose(matrix_from_pose7(seven), matrix, atol=1e-12)


def test_parts_of_a_batch_and_joined_again() -> None:
    rotation = so3.random_rotation(5, generator=torch.Generator().manual_seed(2))
    poses = PoseBatch(rotation, torch.arange(15.0).view(5, 3))
    parts = [poses.part([0, 1]), poses.part(torch.tensor([2, 3, 4]))]
    joined = PoseBatch.joined(parts)
    assert [len(part) for part in (poses, *parts, joined)] == [5, 2, 3, 5]
    assert torch.equal(joined.rotation, poses.rotation)
    assert torch.equal(joined.to("cpu").translation, poses.translation)


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

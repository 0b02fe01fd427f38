"""Farthest points."""

from __future__ import annotations

import fpsample
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from megrasp_core.errors import CloudError
from megrasp_core.meshes import farthest_from_centroid, farthest_points


def reference_farthest(points: np.ndarray, count: int, start: int) -> list[int]:
    chosen, distance = [start], np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return chosen


@pytest.mark.parametrize("size", [3, 17, 64, 65, 500, 3000])
@pytest.mark.parametrize("share", [0.1, 0.5, 1.0, 2.0])
def test_farthest_points_equal_the_plain_loop(size: int, share: float) -> None:
    points = np.random.default_rng(size).normal(size=(size, 3)) + 40.0
    count = max(1, min(int(share * size), 400)) if share < 1 else int(share * size)
    got = farthest_points(points, count)
    assert len(set(got.tolist())) == len(got) == min(count, size)
    assert got[0] == farthest_from_centroid(points)
    if size <= 500:
        assert got.tolist() == reference_farthest(points, len(got), int(got[0]))


@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
@settings(max_examples=40, deadline=None)
def test_every_prefix_is_spread(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.2, 0.2, (120, 3))
    chosen = points[farthest_points(points, count)]
    gaps = cdist(chosen, chosen)
    gaps[np.diag_indices(len(gaps))] = np.inf
    covered = cdist(points, chosen).min(axis=1).max()
    # Gonzalez: no point lies farther from the subset than its members from each other.
    assert covered <= gaps.min() + 1e-6


def test_farthest_points_turn_with_the_cloud() -> None:
    points = np.random.default_rng(1).normal(size=(1500, 3)) * 0.1
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    moved = points @ turn.T + [0.31, -0.22, 0.57]
    first, second = farthest_points(points, 300), farthest_points(moved, 300)
    assert np.mean(first == second) > 0.99


@pytest.mark.parametrize("size", [40, 600])
def test_coincident_points_are_not_repeated(size: int) -> None:
    for points in (np.zeros((size, 3)), np.repeat(np.eye(3)[:2], size // 2, axis=0)):
        for count in (size // 3, size):
            got = farthest_points(points, count)
            assert len(got) == count == len(set(got.tolist())) and got.max() < size


def test_farthest_points_check_their_input() -> None:
    with pytest.raises(CloudError, match=r"\(0, 3\)"):
        farthest_points(np.zeros((0, 3)), 4)
    with pytest.raises(CloudError, match="NaN"):
        farthest_points(np.full((4, 3), np.nan), 2)
    assert farthest_points(np.zeros((5, 3)), 0).shape == (0,)
    assert farthest_points(np.ones((1, 3)), 7).tolist() == [0]
    assert farthest_points(np.random.default_rng(0).normal(size=(200, 3)), 9, start=7)[0] == 7


def test_the_plain_sampler_is_the_fallback_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fpsample, "fps_sampling", None)
    for seed in range(20):
        points = np.random.default_rng(seed).uniform(size=(2700, 3)) * [0.2, 0.1, 0.05]
        assert len(np.unique(farthest_points(points, 1024))) == 1024

"""Timing of the renderer."""

from __future__ import annotations

import json

import pytest

from megrasp_core.benchmarks.rendering import bench_rendering


@pytest.mark.slow
def test_bench_rendering() -> None:
    """A row for each gripper and for the million triangles, and the sums agree with the rows."""
    told: list[tuple[int, int]] = []
    content = bench_rendering(
        names=("franka_hand",),
        procedural=2,
        repeats=1,
        on_progress=lambda done, total: told.append((done, total)),
    )
    assert json.loads(json.dumps(content)) == content
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert [row["gripper"] for row in content["registered"]["rows"]] == ["franka_hand"]
    family = content["procedural"]
    seconds = [row["seconds"] for row in family["rows"]]
    assert family["slowest"]["seconds"] == max(seconds) > 0.0
    assert abs(family["per_second"] - 2.0 / sum(seconds)) < 0.1
    assert content["million_triangles"]["triangles"] == 10**6

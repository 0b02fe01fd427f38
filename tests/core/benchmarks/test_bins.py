"""The measure of the bin finder, and the scenes that it takes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.benchmarks.bin_scenes import bin_scene, table_scene
from megrasp_core.benchmarks.bins import bench_bins, bin_tables, pose_error
from megrasp_core.pointcloud import OrientedBox


def turned(box: OrientedBox, axis: str, degrees: float) -> OrientedBox:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    size = box.size[[1, 0, 2]] if axis == "z" and degrees in (90, -90) else box.size
    return OrientedBox(box.world_from_box @ matrix, size)


def test_the_error_is_that_of_the_opening_over_the_turns_of_a_box() -> None:
    box = OrientedBox.around((0.1, 0.2, 0.3), (0.4, 0.3, 0.2))
    for degrees in (0, 90, 180, -90):
        distance, angle, size = pose_error(turned(box, "z", degrees), box)
        assert distance < 1e-9 and angle < 1e-4 and np.abs(size).max() < 1e-9
    assert pose_error(turned(box, "z", 3), box)[1] == pytest.approx(3)
    # About the middle: the opening goes to the side.
    distance, angle, _ = pose_error(turned(box, "x", 2), box)
    assert angle == pytest.approx(2) and distance == pytest.approx(0.1 * np.deg2rad(2), rel=0.01)
    deeper = OrientedBox.around((0.1, 0.2, 0.25), (0.4, 0.3, 0.3))
    distance, _, size = pose_error(deeper, box)
    assert distance < 1e-9 and size[2] == pytest.approx(0.1)


@pytest.mark.slow
def test_a_seed_makes_a_scene() -> None:
    first, second = bin_scene(3)[0], bin_scene(3)[0]
    np.testing.assert_array_equal(first.cloud.points, second.cloud.points)
    assert first.features == second.features
    assert not np.array_equal(first.cloud.points[:100], bin_scene(4)[0].cloud.points[:100])
    for scene in (first, table_scene(3)):
        assert np.linalg.norm(scene.gravity) == pytest.approx(1)
        assert scene.cloud.viewpoint is not None
    box = first.boxes[0]
    assert box.rotation[:, 2] @ first.gravity < -np.cos(np.deg2rad(11))
    assert box.contains(first.cloud.points).sum() > 100
    assert 0 <= first.fill <= 1 and not table_scene(3).boxes


@pytest.mark.slow
def test_the_result_counts_what_its_rows_say() -> None:
    calls: list[tuple[int, int]] = []
    content = bench_bins(3, 50, on_progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (6, 6) and len(content["bins"]) == len(content["tables"]) == 3
    assert content["right"]["successes"] == sum(row["right"] for row in content["bins"])
    assert content["false"]["successes"] == sum(row["found"] for row in content["tables"])
    assert content["right"]["successes"] >= 2 and not content["false"]["successes"]
    lines = bin_tables(content).splitlines()
    assert lines[2].startswith(f"| all with a bin | {content['right']['successes']} of 3 |")

"""The scene viewer over HTTP and through what its panel does."""

from __future__ import annotations

import io
import json
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from megrasp_core.cli.common import read_region
from megrasp_core.pointcloud import OrientedBox

from .conftest import Bench, scene

pytestmark = pytest.mark.slow


def test_the_page_loads(bench: Bench) -> None:
    server = bench.viewer.server
    url = f"http://{server.get_host()}:{server.get_port()}"
    assert url.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(url, timeout=60) as answer:
        assert b"<html" in answer.read().lower()


def test_synthesize_gives_what_a_synthesis_gives(bench: Bench) -> None:
    viewer = bench.viewer
    found = viewer.synthesize()
    assert found is not None and found.grasps, viewer.status.content
    expected = viewer.synthesizer.synthesize(scene(bench.heights[0]), viewer.asked)
    assert viewer.asked.num_grasps == 3
    for mine, theirs in zip(found.grasps, expected.grasps, strict=True):
        np.testing.assert_allclose(mine.world_from_tcp, theirs.world_from_tcp, atol=1e-9)
        assert mine.score == pytest.approx(theirs.score)
    assert found.rejected == expected.rejected
    written = json.loads(viewer.grasps_file())
    assert len(written["grasps"]) == len(found.grasps) and written["frame"] == "world"
    assert Image.open(io.BytesIO(viewer.picture())).size[0] > 500


def test_lists_and_sliders_choose_what_is_drawn(bench: Bench) -> None:
    viewer = bench.viewer
    viewer.synthesize()
    get = viewer.server.scene.get_handle_by_name
    assert viewer.lists is not None
    node, first = get("/gripper"), viewer.lists["ranked"][0]
    assert node is not None and node.visible
    np.testing.assert_allclose(node.position, first.world_from_gripper[:3, 3], atol=1e-6)
    assert f"score | {first.score:.2f}" in viewer.details.content
    assert get("/path/approach") is not None
    viewer.paths.value = False
    assert get("/path/approach") is None
    for option in viewer.list.options:
        viewer.list.value = option
        name = option.rsplit(" ", 1)[0]
        chosen = viewer.grasp
        assert chosen is not None and chosen is viewer.lists[name][0]
        assert ("rejected" in viewer.details.content) == (name != "ranked")
    viewer.list.value = viewer.list.options[0]
    several = len(viewer.lists["ranked"]) > 1
    assert (get("/others/forks") is not None) == several
    viewer.forks.value = False
    assert get("/others/forks") is None
    viewer.forks.value = True


def test_closing_the_fingers_moves_links(bench: Bench) -> None:
    viewer = bench.viewer
    scene_nodes = viewer.server.scene
    links = [f"/gripper/link_{body}" for body in range(viewer.synthesizer.gripper.model.nbody)]

    def places() -> np.ndarray:
        found = [scene_nodes.get_handle_by_name(name) for name in links]
        return np.array([[*node.position, *node.wxyz] for node in found if node is not None])

    before = places()
    viewer.fingers.value = 1.0
    assert np.abs(places() - before).max() > 1e-3
    viewer.fingers.value = 0.0
    np.testing.assert_allclose(places(), before, atol=1e-9)


def test_unknown_space_is_under_what_hides_it(bench: Bench) -> None:
    viewer = bench.viewer
    viewer.spaces["unknown"].value = True
    assert viewer.space is not None
    assert viewer.server.scene.get_handle_by_name("/space/unknown") is not None
    box = (np.abs(viewer.space.inside[:, :2]) < [0.02, 0.03]).all(axis=1)
    assert box.sum() > 10, "the body of the box is taken for its inside"
    assert (np.abs(viewer.space.unknown[:, :2]) < 0.13).all()
    viewer.spaces["unknown"].value = False
    assert viewer.server.scene.get_handle_by_name("/space/unknown") is None


def test_the_region_is_a_file_that_synthesize_reads(bench: Bench, tmp_path: Path) -> None:
    region = bench.viewer.region
    before, walls = region.shape, region.walls.value
    moved = OrientedBox.around((0.01, -0.02, 0.1), (0.2, 0.21, 0.22))
    region.move_to(moved)
    region.walls.value = False
    assert bench.viewer.asked.region is not None
    file = tmp_path / "region.json"
    file.write_bytes(bench.viewer.region_file())
    box, is_bin = read_region(file)
    np.testing.assert_allclose(box.world_from_box, moved.world_from_box, atol=1e-6)
    np.testing.assert_allclose(box.size, moved.size, atol=1e-6)
    assert not is_bin
    region.used.value = False
    assert bench.viewer.asked.region is None
    region.used.value, region.walls.value = True, walls
    region.move_to(before)


def test_a_wrong_request_is_told_on_the_page(bench: Bench) -> None:
    viewer = bench.viewer
    region = viewer.region.shape
    viewer.region.move_to(OrientedBox.around((5.0, 5.0, 5.0), (0.1, 0.1, 0.1)))
    assert viewer.synthesize() is None
    assert "region" in viewer.status.content
    assert not viewer.start.disabled
    viewer.region.move_to(region)
    assert viewer.synthesize() is not None


def test_following_leaves_alone_what_is_looked_at(bench: Bench) -> None:
    viewer, before = bench.viewer, bench.heights[0]

    def height() -> float:
        return viewer.cloud.points[:, 2].max()

    viewer.refresh()
    bench.heights[0] = 0.07
    viewer.follow()
    assert height() == pytest.approx(0.07)
    viewer.spaces["seen"].value = True
    bench.heights[0] = 0.08
    viewer.follow()
    assert height() == pytest.approx(0.07), "its known space is shown"
    viewer.spaces["seen"].value = False
    viewer.follow()
    assert height() == pytest.approx(0.08) and viewer.space is None
    assert viewer.synthesize() is not None
    bench.heights[0] = before
    viewer.follow()
    assert height() == pytest.approx(0.08) and viewer.lists is not None
    viewer.refresh()
    assert height() == pytest.approx(before)


def test_executing_asks_for_another_cloud(bench: Bench) -> None:
    viewer = bench.viewer
    viewer.gripper.value = "robotiq_3f"
    assert viewer.synthesizer.gripper.name == "robotiq_3f"
    assert viewer.lists is None and viewer.grasp is None
    viewer.gripper.value = "robotiq_2f85"
    viewer.synthesize()
    grasp = viewer.grasp
    viewer._guarded(viewer._carry_out)
    assert bench.executed == [(grasp, "robotiq_2f85")]
    assert viewer.status.content == "**it holds**"
    assert viewer.cloud.points[:, 2].max() == pytest.approx(0.06)
    assert viewer.lists is None
    viewer._guarded(viewer._carry_out)
    assert "Synthesize first" in viewer.status.content

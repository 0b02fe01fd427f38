"""The gripper viewer through what its panel does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from megrasp_core.grippers import load_description, load_gripper
from megrasp_core.viewer import GripperViewer, open_server

pytestmark = pytest.mark.slow


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[GripperViewer]:
    pytest.importorskip("viser", reason="viser is missing: pip install 'megrasp-core[view]'")
    server = open_server(port=0)
    yield GripperViewer(
        server, load_gripper("schunk_wsg32"), findings=["kind: parallel"], folder=tmp_path
    )
    server.stop()


def test_it_shows_the_gripper_and_its_pads(viewer: GripperViewer) -> None:
    get = viewer.server.scene.get_handle_by_name
    assert "Schunk WSG-32" in viewer.text.content
    pads = [get(f"/gripper/pad_{group}") for group in (0, 1)]
    assert all(pad is not None for pad in pads)
    # The first group is on -X.
    assert pads[0].points[:, 0].mean() < 0 < pads[1].points[:, 0].mean()
    tcp = get("/gripper/tcp")
    np.testing.assert_allclose(tcp.position, viewer.gripper.tcp, atol=1e-9)
    viewer.fingers.value = 0.5
    assert get("/gripper/pad_0") is None
    viewer.collision.value = True
    assert get("/gripper/collision").visible


def test_corrections_are_applied_and_written(viewer: GripperViewer, tmp_path: Path) -> None:
    before = viewer.gripper.description
    viewer.tcp.value = (0.0, 0.0, 0.1)
    viewer.max_width.value = 0.05
    joint, field = next(iter(viewer.joints["open"].items()))
    field.value = round(0.9 * field.value, 6)
    assert viewer.correct(), viewer.status.content
    assert viewer.gripper.description.tcp == (0.0, 0.0, 0.1)
    assert viewer.gripper.description.max_width == 0.05
    assert viewer.gripper.posture("open")[joint] == pytest.approx(field.value)
    written = yaml.safe_load(viewer.file())
    assert written["tcp"] == [0.0, 0.0, 0.1] and written["name"] == before.name
    viewer._write()
    assert load_description(tmp_path).closed == before.closed
    assert load_description(tmp_path).max_width == 0.05


def test_a_wrong_correction_is_told_and_changes_nothing(viewer: GripperViewer) -> None:
    gripper = viewer.gripper
    _, field = next(iter(viewer.joints["open"].items()))
    field.value = 5.0
    assert not viewer.correct()
    assert "limit" in viewer.status.content
    assert viewer.gripper is gripper

"""What a viewer is made of, without a server: lists, forks, files that change."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.errors import InvalidRequestError, MissingPackageError
from megrasp_core.grippers import load_gripper
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import RankedGrasp, Synthesis, SynthesisRequest
from megrasp_core.viewer import CloudFile, how_to_reach, open_server
from megrasp_core.viewer.figure import fork
from megrasp_core.viewer.grasp_lists import RANKED, GraspLists, everything, report


def grasp(score: float, reason: str = "") -> RankedGrasp:
    pose = np.eye(4)
    return RankedGrasp(
        pose, pose, pose, pose, score=score, width=float("nan"), clearance=0.0042, tilt=0.5,
        collision_free=not reason, reason=reason,
    )  # fmt: skip


def answer(*grasps: RankedGrasp, **rejected: int) -> Synthesis:
    return Synthesis(
        list(grasps), rejected, {"total": 0.1}, seed=1, drawn=9, evaluations=20,
        gripper="robotiq_2f85", model="m",
    )  # fmt: skip


def test_everything_draws_the_same_and_keeps_all() -> None:
    asked = everything(SynthesisRequest(num_grasps=5, drawn=40, seed=3))
    assert (asked.num_grasps, asked.drawn, asked.seed, asked.keep_all) == (40, 40, 3, True)


def test_lists_hold_the_ranked_and_the_others_by_reason() -> None:
    grasps = [grasp(0.9), grasp(0.8), grasp(0.7), grasp(0.6, "collision"), grasp(0.5, "tilt"),
              grasp(0.4, "collision")]  # fmt: skip
    lists = GraspLists(answer(*grasps, collision=2, tilt=1, duplicate=0), num_grasps=2)
    assert lists.names == [RANKED, "collision", "surplus", "tilt"]
    assert [one.score for one in lists[RANKED]] == [0.9, 0.8]
    assert [one.score for one in lists["collision"]] == [0.6, 0.4]
    assert [one.reason for one in lists["surplus"]] == ["surplus"]
    assert lists["no such"] == []
    assert lists.answer.grasps == grasps[:2]
    assert lists.answer.rejected == {"collision": 2, "tilt": 1, "duplicate": 0, "surplus": 1}


def test_a_report_says_why() -> None:
    text = report(grasp(0.5, "collision"), 2, 3)
    assert "2 of 3" in text and "**collision**" in text
    assert "4.2 mm" in text and "29 degrees" in text
    assert "| width between the fingers | unknown |" in text


def test_a_fork_ends_beside_the_tcp() -> None:
    gripper = load_gripper("robotiq_2f85")
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    lines = fork(gripper, [np.eye(4), pose])
    assert lines.shape == (8, 2, 3)
    np.testing.assert_allclose(lines[2:4, 1].mean(axis=0), gripper.tcp, atol=1e-6)
    np.testing.assert_allclose(np.ptp(lines[2:4, 1, 0]), gripper.description.max_width, atol=1e-6)
    np.testing.assert_allclose(lines[4:], lines[:4] + pose[:3, 3], atol=1e-6)
    assert fork(gripper, []).shape == (0, 2, 3)


def test_a_file_that_is_written_again_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    file = CloudFile(path, lambda at: Cloud(np.full((1, 3), float(at.read_text()))))
    assert not file.changed()
    path.write_text("1")
    assert file.changed()
    assert file.read().points[0, 0] == 1.0
    assert not file.changed()
    path.write_text("2")
    os.utime(path, ns=(1, 1))
    assert file.changed()
    path.unlink()
    assert not file.changed()


def test_a_missing_viser_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'megrasp-core\[view\]'"):
        open_server(port=0)


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 0), ("no.such.host.invalid", 80)])
def test_an_address_of_another_machine_is_told(host: str, port: int) -> None:
    pytest.importorskip("viser", reason="viser is missing: pip install 'megrasp-core[view]'")
    with pytest.raises(InvalidRequestError, match="expected an address of this machine"):
        open_server(host, port)


def test_how_to_reach_a_page() -> None:
    class Server:
        def __init__(self, host: str) -> None:
            self.host = host

        def get_host(self) -> str:
            return self.host

        def get_port(self) -> int:
            return 8123

    here, away = how_to_reach(Server("127.0.0.1"))  # type: ignore[arg-type]
    assert here == "open http://127.0.0.1:8123"
    assert "ssh -L 8123:127.0.0.1:8123 " in away
    (anywhere,) = how_to_reach(Server("0.0.0.0"))  # type: ignore[arg-type]
    assert anywhere.endswith(":8123") and "0.0.0.0" not in anywhere

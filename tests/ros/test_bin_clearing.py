"""bin_clearing against the real sim_cell and a scripted grasp server, as three processes."""

import json
import signal
import sys
from pathlib import Path

import pytest

pytest.importorskip("megrasp_msgs", reason="the workspace is not sourced (launch_scripts/env.sh)")

from cell_processes import WAIT, Processes, processes, save_boxes, until  # noqa: E402

DOUBLE = Path(__file__).with_name("analytic_grasp_server.py")
DOMAIN = 53
GRIPPERS = ["robotiq_2f85", "franka_hand"]


@pytest.fixture
def cell(tmp_path):
    save_boxes(tmp_path / "boxes", 4, (0.03, 0.05, 0.05))
    with processes(DOMAIN, tmp_path) as started:
        started.start(
            "sim_cell",
            objects_dir=tmp_path / "boxes",
            num_objects=4,
            grippers=GRIPPERS,
            seed=2,
            cloud_rate=5.0,
        )
        yield started


def start_double(cell: Processes, *arguments: str) -> None:
    cell.start_command("grasp_server", [sys.executable, str(DOUBLE), *arguments])


def start_clearing(cell: Processes, **parameters: object):
    defaults: dict[str, object] = {
        "grippers": GRIPPERS,
        "num_objects": 4,
        "out": cell.folder / "out",
        "call_timeout": 30.0,
    }
    return cell.start("bin_clearing", **(defaults | parameters))


def test_a_bin_is_emptied_with_two_grippers(cell):
    start_double(cell)
    clearing = start_clearing(cell)
    assert clearing.wait(timeout=90) == 0, cell.logs()
    log = cell.log("bin_clearing")
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    assert summary["objects_at_start"] == 4
    assert len(summary["removed"]) >= 3, log
    assert len(set(summary["removed"])) == len(summary["removed"])
    assert summary["objects_left"] == 4 - len(summary["removed"])
    assert summary["system_failure"] == ""
    used = [pick["gripper"] for pick in summary["picks"]]
    assert used[0] == GRIPPERS[0]
    assert used[-1] == GRIPPERS[1]
    assert summary["per_gripper"][GRIPPERS[0]]["removed"] == 2
    assert log.index("mounted robotiq_2f85") < log.index("mounted franka_hand")
    assert log.count("pick ") == summary["attempts"]
    assert "set_gripper franka_hand" in cell.log("grasp_server")
    for pick in summary["picks"]:
        if pick["returned"]:
            assert Path(pick["picture"]).stat().st_size > 5000
    assert Path(summary["contact_sheet"]).stat().st_size > 5000


def test_failed_grasps_are_excluded_and_the_gripper_is_handed_on(cell):
    """The double grasps into the air 2 times per gripper: the third try of each succeeds."""
    start_double(cell, "--fail-first", "2")
    clearing = start_clearing(cell, pictures="false")
    assert clearing.wait(timeout=90) == 0, cell.logs()
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    first = summary["picks"][:3]
    assert [pick["success"] for pick in first] == [False, False, True]
    assert [pick["reason"] for pick in first[:2]] == ["no_contact", "no_contact"]
    asked = [line for line in cell.log("grasp_server").splitlines() if "synthesize" in line]
    assert "excluded 0 seed 2" in asked[0]
    assert "excluded 1 seed 3" in asked[1]
    assert "excluded 2 seed 4" in asked[2]
    assert "excluded 0 seed 5" in asked[3]


def test_objects_that_nobody_can_grasp_are_given_up(cell):
    start_double(cell, "--fail-first", "1000")
    clearing = start_clearing(cell, pictures="false", tries=1)
    assert clearing.wait(timeout=90) == 0, cell.logs()
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    assert summary["objects_left"] == 4
    assert summary["removed"] == []
    assert not summary["cleared"]
    assert "given up" in summary["ended"]
    assert summary["attempts"] <= 2 * 4


def test_a_broken_server_ends_the_run_with_1(cell):
    start_double(cell, "--error", "300")
    clearing = start_clearing(cell)
    assert clearing.wait(timeout=90) == 1
    assert "error 300: as ordered by the test" in cell.logs()
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    assert "error 300" in summary["system_failure"]
    assert summary["attempts"] == 0


def test_a_missing_server_is_named(tmp_path):
    with processes(DOMAIN, tmp_path) as started:
        clearing = started.start("bin_clearing", ready_timeout=1.0, out=tmp_path / "out")
        assert clearing.wait(timeout=WAIT) == 1
        assert "synthesize_grasps (grasp_server) is not there after 1 s" in started.log("bin_clearing")


def test_wrong_parameters_end_it_with_2(tmp_path):
    with processes(DOMAIN, tmp_path) as started:
        clearing = started.start("bin_clearing", region__size=[0.4, 0.3], out=tmp_path / "out")
        assert clearing.wait(timeout=WAIT) == 2
        assert "region.size 2 numbers" in started.log("bin_clearing")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_on_a_signal_and_leaves_a_summary(cell, number):
    start_double(cell, "--fail-first", "1000")
    start_clearing(cell, tries=100, pictures="false")
    assert until(lambda: "pick  1" in cell.log("bin_clearing")), cell.logs()
    assert cell.stop("bin_clearing", number) == 130
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    assert summary["ended"] == "interrupted"

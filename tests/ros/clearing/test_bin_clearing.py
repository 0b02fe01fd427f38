"""bin_clearing against the real sim_cell and a scripted grasp server, as three processes."""

import json
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from cell_processes import WAIT, Processes, own_domain, processes, save_boxes, until

from megrasp_core.grippers import load_gripper
from megrasp_core.storage import AttemptFolder

pytestmark = pytest.mark.slow

DOUBLE = Path(__file__).parents[2] / "support" / "analytic_grasp_server.py"
DOMAIN = own_domain(4)
GRIPPERS = ["robotiq_2f85", "franka_hand"]
RUN = 4 * WAIT
"""Longest time (s) for a whole run: three processes start, and each pick has its pictures."""


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
        "call_timeout": WAIT,
        "ready_timeout": WAIT,
    }
    return cell.start("bin_clearing", **(defaults | parameters))


def test_a_bin_is_emptied_with_two_grippers(cell):
    start_double(cell, "--width", "0.03")
    clearing = start_clearing(cell)
    assert clearing.wait(timeout=RUN) == 0, cell.logs()
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
    lifted = [pick for pick in summary["picks"] if pick["success"]]
    # The cell tells where the fingers stood: mostly on the narrow side of a box, as was said, and
    # now and then across another one.
    for pick in lifted:
        near = abs(pick["closed_width"] - 0.03) <= pick["width_tolerance"]
        assert pick["as_expected"] == near
        assert pick["failure"] == ("" if near else "unexpected_width")
    assert sum(pick["as_expected"] for pick in lifted) >= 2
    assert "(as expected: 30)" in log
    for pick in summary["picks"]:
        if pick["returned"]:
            assert Path(pick["picture"]).stat().st_size > 5000
    assert Path(summary["contact_sheet"]).stat().st_size > 5000


def test_failed_grasps_are_excluded_and_the_gripper_is_handed_on(cell):
    """The double grasps into the air 2 times per gripper: the third try of each succeeds."""
    start_double(cell, "--fail-first", "2", "--width", "0.07")
    record = cell.folder / "attempts"
    clearing = start_clearing(cell, pictures="false", record=record)
    assert clearing.wait(timeout=RUN) == 0, cell.logs()
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    first = summary["picks"][:3]
    assert [pick["success"] for pick in first] == [False, False, True]
    assert [pick["reason"] for pick in first[:2]] == ["no_contact", "no_contact"]
    # What was lifted is not as wide as it was said to be.
    assert [pick["failure"] for pick in first] == [*2 * ["no_contact"], "unexpected_width"]
    assert [pick["as_expected"] for pick in first] == [False, False, False]
    assert summary["failures"]["no_contact"] >= 2
    log = cell.log("bin_clearing")
    assert "failed (no_contact: the fingers closed on nothing)" in log
    assert "(not as expected: 70)" in log
    asked = [line for line in cell.log("grasp_server").splitlines() if "synthesize" in line]
    assert "excluded 0 seed 2" in asked[0]
    assert "excluded 1 seed 3" in asked[1]
    assert "excluded 2 seed 4" in asked[2]
    # What failed beside the object that was lifted is allowed again.
    assert asked[3].endswith(("excluded 0 seed 5", "excluded 1 seed 5"))
    # Every attempt is on disk, with the cloud it was made from.
    kept = list(AttemptFolder(record).read_all(notes := []))
    assert not notes, notes
    tried = [pick for pick in summary["picks"] if pick["returned"]]
    assert [attempt.success for attempt in kept] == [pick["success"] for pick in tried]
    assert [attempt.reason for attempt in kept] == [pick["reason"] for pick in tried]
    assert [attempt.gripper for attempt in kept] == [pick["gripper"] for pick in tried]
    assert kept[0].gripper_hash == load_gripper(kept[0].gripper).hash
    for attempt in kept:
        assert attempt.frame == "cell" and len(attempt.points) > 10_000
        tip = attempt.world_from_tcp[:3, 3] - [0, 0, 0 if attempt.success else 0.06]
        assert np.linalg.norm(attempt.points - tip, axis=1).min() < 0.03


def test_a_broken_server_ends_the_run_with_1(cell):
    start_double(cell, "--error", "300")
    clearing = start_clearing(cell)
    assert clearing.wait(timeout=WAIT) == 1
    assert "error 300: as ordered by the test" in cell.logs()
    summary = json.loads((cell.folder / "out" / "summary.json").read_text())
    assert "error 300" in summary["system_failure"]
    assert summary["attempts"] == 0


def test_it_ends_by_itself_without_servers_and_on_signals(tmp_path):
    """1 when a server is missing, 2 for wrong parameters, 130 for a signal."""
    with processes(own_domain(5), tmp_path) as started:
        alone = {"out": tmp_path / "alone", "ready_timeout": 1.0}
        waiting = {"out": tmp_path / "waiting", "ready_timeout": 600.0}
        started.start("bin_clearing", label="alone", **alone)
        started.start("bin_clearing", label="wrong", region__size=[0.4, 0.3])
        for label in ("SIGINT", "SIGTERM"):
            started.start("bin_clearing", label=label, **waiting)
        assert started.running["alone"].wait(timeout=WAIT) == 1
        assert "synthesize_grasps (grasp_server) is not there after 1 s" in started.log("alone")
        summary = json.loads((tmp_path / "alone" / "summary.json").read_text())
        assert "grasp_server" in summary["system_failure"]
        assert started.running["wrong"].wait(timeout=WAIT) == 2
        assert "region.size 2 numbers" in started.log("wrong")
        # The folder is made at the start of the run, when the signal handlers are in place.
        assert until((tmp_path / "waiting").is_dir)
        for label in ("SIGINT", "SIGTERM"):
            assert started.stop(label, signal.Signals[label]) == 130, started.log(label)
        summary = json.loads((tmp_path / "waiting" / "summary.json").read_text())
        assert summary["ended"] == "interrupted"

"""launch_scripts/demo.sh: three processes empty a bin with the committed model, and clean up."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from PIL import Image

pytestmark = pytest.mark.slow

pytest.importorskip("megrasp_msgs", reason="the workspace is not built or not sourced")

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "launch_scripts" / "demo.sh"
LIMIT = 900.0
"""Seconds; a free machine needs about a tenth of it."""


def start_demo(out: Path, *arguments: str) -> subprocess.Popen[str]:
    command = ["bash", str(DEMO), "--no-setup", "--out", str(out), *arguments]
    # Every run takes a domain of its own unless it is told one.
    env = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    return subprocess.Popen(
        command,
        env=env,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        # A shell starts background jobs with SIGINT ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def assert_nothing_runs(group: int) -> None:
    """No process of the demo's group is left; the last one may need a moment to be reaped."""
    for _ in range(600):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.killpg(group, signal.SIGKILL)
    pytest.fail("processes of the demo were left behind")


def test_the_demo_empties_a_bin(tmp_path):
    from megrasp_core.errors import ModelError
    from megrasp_core.network import find_model

    try:
        find_model(None)
    except ModelError as error:
        pytest.skip(f"no model is committed: {error}")
    out = tmp_path / "out"
    demo = start_demo(out, "--objects", "4")
    try:
        output, _ = demo.communicate(timeout=LIMIT)
    finally:
        if demo.poll() is None:
            os.killpg(demo.pid, signal.SIGKILL)
    assert demo.returncode == 0, output
    assert_nothing_runs(demo.pid)
    summary = json.loads((out / "summary.json").read_text())
    picks = summary["picks"]
    assert summary["objects_at_start"] == 4
    assert output.count("\npick ") == len(picks)
    assert picks[0]["gripper"] == "robotiq_2f85"
    assert {pick["gripper"] for pick in picks} == {"robotiq_2f85", "robotiq_3f"}
    assert summary["objects_left"] <= 2, output
    for pick in picks:
        with Image.open(pick["picture"]) as image:
            assert image.width > 400
            assert len(image.convert("RGB").resize((64, 64)).getcolors(4096) or range(4096)) > 50
    with Image.open(summary["contact_sheet"]) as image:
        assert image.width > 800
    for name in ("sim_cell", "grasp_server", "bin_clearing"):
        assert (out / f"{name}.log").is_file()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_all_processes(tmp_path, number):
    demo = start_demo(tmp_path)
    try:
        for _ in range(3000):
            if (tmp_path / "bin_clearing.log").is_file():
                break
            time.sleep(0.1)
        else:
            pytest.fail("the demo did not start its nodes")
        demo.send_signal(number)
        demo.communicate(timeout=LIMIT)
        assert demo.returncode == 128 + number
        assert_nothing_runs(demo.pid)
    finally:
        if demo.poll() is None:
            os.killpg(demo.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--objects"], "without a value"),
        (["--objects", "0"], "whole number"),
        (["--seed", "x"], "whole number"),
        (["--gripper", "x"], "unknown argument --gripper"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, arguments, message):
    demo = start_demo(tmp_path / "out", *arguments)
    output, _ = demo.communicate(timeout=60)
    assert demo.returncode == 2
    assert message in output
    assert "--objects N" in output or "whole number" in output

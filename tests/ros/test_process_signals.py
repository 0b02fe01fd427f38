"""Signals before a node has anything to put in order, and while it does so."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from cell_processes import WAIT, default_signals, own_domain, processes, until

IMPORTING = """
import time
from pathlib import Path
from megrasp_ros.process import StopSignals
signals = StopSignals()
print("ready", flush=True)
time.sleep(600)
"""
ORDERLY = """
import sys, time
from megrasp_ros.process import StopSignals
signals = StopSignals()
signals.orderly = True
print("ready", flush=True)
while not signals.event.wait(0.2):
    pass
print("ending", flush=True)
time.sleep(1.0)
sys.exit(0)
"""
MAKING = """
from rclpy.executors import SingleThreadedExecutor
from megrasp_ros.process import StopSignals, run_program
import rclpy
signals = StopSignals()
def run():
    print("ready", flush=True)
    while rclpy.ok():
        pass
    SingleThreadedExecutor()
run_program(run, signals=signals)
"""


def start(script: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=default_signals,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_during_the_imports_ends_the_process(number: int, code: int) -> None:
    process = start(IMPORTING)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (code, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_further_signals_while_things_are_put_in_order_are_nothing(number: int) -> None:
    process = start(ORDERLY)
    process.send_signal(number)
    assert process.stdout is not None
    assert process.stdout.readline() == "ending\n"
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_was_half_made_at_a_signal_says_nothing(number: int) -> None:
    process = start(MAKING)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (130, "")


def hears_sigterm(pid: int) -> bool:
    """Whether a process has a handler for SIGTERM, which Python alone has not."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("SigCgt:"):
            return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


DELAYS = (0.0, 0.5, 2.0, 8.0)
"""Seconds after a node begins to hear signals: imports, making the node, at work."""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "name", ["grasp_server", "sim_cell", "bin_clearing", "tool_changer", "cloud_replay"]
)
def test_a_node_ends_in_every_phase(name: str, number: int, tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.npy"
    np.save(cloud, np.random.default_rng(0).uniform(0.1, 0.2, (10, 3)))
    given = {"cloud_replay": {"file": cloud}, "bin_clearing": {"out": tmp_path / "out"}}
    with processes(own_domain(1), tmp_path) as running:
        for delay in DELAYS:
            process = running.start(name, label=f"{name}_{delay}", **given.get(name, {}))
            assert until(lambda: hears_sigterm(process.pid), WAIT)  # noqa: B023
            time.sleep(delay)
            # Twice, as ros2 launch and a shell's Ctrl-C do together.
            process.send_signal(number)
            time.sleep(0.02)
            code = running.stop(f"{name}_{delay}", number)
            assert code in (0, 130), (delay, running.log(f"{name}_{delay}"))
            assert "Traceback" not in running.log(f"{name}_{delay}")


def test_arguments_that_cannot_be_read_end_a_node_with_2(tmp_path: Path) -> None:
    with processes(own_domain(1), tmp_path) as running:
        process = running.start("tool_changer", x="[0, 0, 1.0]")
        assert process.wait(WAIT) == 2
        log = running.log("tool_changer")
    assert "Traceback" not in log and "[0.0, 0.0, 1.0]" in log

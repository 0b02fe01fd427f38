"""Signals before a node has anything to put in order, and while it does so."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from cell_processes import default_signals

IMPORTING = """
import time
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

"""Entry points of the executables: signals are heard before the long imports begin."""

from __future__ import annotations

import sys
from importlib import import_module

from .process import INTERRUPTED, StopSignals


def _run(module: str) -> None:
    signals = StopSignals()
    import_module(f"megrasp_ros.{module}").main(signals=signals)


def grasp_server() -> None:
    """Run the executable `grasp_server`."""
    _run("server.grasp_server")


def sim_cell() -> None:
    """Run the executable `sim_cell`."""
    _run("cell.sim_cell")


def bin_clearing() -> None:
    """Run the executable `bin_clearing`."""
    _run("clearing.bin_clearing")


def tool_changer() -> None:
    """Run the executable `tool_changer`."""
    _run("tool_changer")


def cloud_replay() -> None:
    """Run the executable `cloud_replay`."""
    _run("cloud_replay")


def bench_node() -> None:
    """Run the executable `bench_node`."""
    _run("trials.bench_node")


def megrasp_call() -> None:
    """Run the executable `megrasp_call`, in which Ctrl-C ends one call."""
    try:
        main = import_module("megrasp_ros.call.app").main
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    main()

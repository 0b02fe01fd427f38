"""Speed of grasp_server as its clients see it; what `megrasp bench --stage ros` starts.

Rates of 15 and 30 clouds of 640 x 480 points a second, each subscription mode: seconds from
request to answer and the server's part of it, CPU while nothing is asked for, clouds that did not
arrive, round trips of a small service while a synthesis runs.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
from megrasp_msgs.srv import SynthesizeGrasps
from rcl_interfaces.srv import GetParameters
from rclpy import get_default_context

from megrasp_core.machine import processor
from megrasp_ros.process import StopSignals, run_program

from .camera import DONE, picture, region_parameters
from .server_process import STARTING, ServerProcess, TrialError, camera_process, server_process
from .soak import quantiles

RATES = (15.0, 30.0)
MODES = ("on_demand", "continuous")
IDLE = 10.0
"""Seconds over which CPU is measured."""

CLOUDS = 20.0
"""Seconds of clouds of which it is counted how many arrive."""

LONGEST = 600.0
"""Longest time (s) for an answer on a busy machine."""

PAUSE = 0.002
"""Between two round trips (s)."""

Progress = Callable[[str], None]


def bench(
    repeats: int, note: str, tell: Progress, command: list[str] | None = None
) -> dict[str, Any]:
    """Return the result file; `command` in place of grasp_server."""
    others = other_load()
    points = picture()
    idle: list[dict[str, Any]] = []
    requests: list[dict[str, Any]] = []
    lost: list[dict[str, Any]] = []
    parameters = {**region_parameters(), "request_timeout": LONGEST}
    context = get_default_context()
    with server_process(parameters, command=command, context=context) as server:
        server.wait_until_active()
        tell("without a camera")
        idle.append({"mode": "on_demand", "clouds_per_second": 0.0, "cpu": idle_cpu(server)})
        for mode in MODES:
            server.set_parameters(points_subscription=mode)
            for rate in RATES:
                about = {"mode": mode, "clouds_per_second": rate}
                tell(f"{mode}, {rate:g} Hz")
                with camera_process(server, points, rate=rate):
                    wait_for_clouds(server)
                    idle.append({**about, "cpu": idle_cpu(server)})
                    requests.append({**about, **request_times(server, repeats)})
                    if mode == "continuous":
                        requests[-1]["round_trip_under_load"] = round_trips(server)
        for rate in RATES:
            tell(f"clouds at {rate:g} Hz")
            lost.append({"clouds_per_second": rate, **clouds_lost(server, points, rate)})
        memory = server.memory()
        model = server.diagnostics()["model"]
    return {
        "protocol": "ros_bench",
        "model": model,
        "gripper": "robotiq_2f85",
        "drawn": 100,
        "returned": 20,
        "cloud": {"width": 640, "height": 480, "bytes": points.shape[0] * points.shape[1] * 16},
        "repeats": repeats,
        "requests": requests,
        "clouds": lost,
        "idle_share_of_a_core": idle,
        "memory_mib": round(memory, 1),
        "fast_dds_profile": Path(os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "none")).name,
        "hardware": {**processor(), "cores_busy_with_others": others, "note": note},
    }


def other_load(seconds: float = 3.0) -> float:
    """Return how many cores are busy before anything is started here."""
    psutil.cpu_percent()
    time.sleep(seconds)
    return round(psutil.cpu_percent() / 100.0 * (psutil.cpu_count() or 1), 2)


def idle_cpu(server: ServerProcess) -> float:
    """Return the share of a core that the server takes while nothing is asked for."""
    before, started = server.cpu_seconds(), time.monotonic()
    time.sleep(IDLE)
    return round((server.cpu_seconds() - before) / (time.monotonic() - started), 4)


def wait_for_clouds(server: ServerProcess) -> None:
    """Wait until the camera is there. Raises TrialError."""
    end = time.monotonic() + STARTING
    while time.monotonic() < end:
        if server.node.count_publishers("points"):
            # Then the server sees it, too.
            time.sleep(1.0)
            return
        time.sleep(0.1)
    raise TrialError(
        f"no camera after {STARTING:g} s; see whether python -m megrasp_ros.trials.camera runs"
    )


def request_times(server: ServerProcess, repeats: int) -> dict[str, Any]:
    """Return seconds from request to answer, the wait for a cloud, and what is neither this nor
    synthesis.
    """
    total, wait, own = [], [], []
    for repeat in range(repeats + 1):
        started = time.monotonic()
        request = SynthesizeGrasps.Request(num_grasps=20, seed=repeat + 1)
        answer = server.call(request, LONGEST)
        seconds = time.monotonic() - started
        if answer is None or not answer.success:
            why = "no answer in time" if answer is None else answer.error_msg
            raise TrialError(f"the synthesis failed: {why}. The log ends\n{server.log_end()}")
        if repeat:  # the first one warms up
            timing = answer.timing
            parts = timing.perceive + timing.encode + timing.sample + timing.check
            total.append(seconds)
            wait.append(timing.wait)
            own.append(seconds - timing.wait - parts)
    return {
        "request_to_answer": quantiles(total),
        "wait_for_cloud": quantiles(wait),
        "rest": quantiles(own),
    }


def round_trips(server: ServerProcess) -> dict[str, float]:
    """Return the seconds of get_parameters, again and again while a synthesis runs."""
    running = server.client(SynthesizeGrasps).call_async(SynthesizeGrasps.Request(num_grasps=20))
    seconds = []
    while not running.done():
        started = time.monotonic()
        if server.call(GetParameters.Request(names=["drawn"])) is None:
            raise TrialError("get_parameters was not answered while a synthesis ran")
        seconds.append(time.monotonic() - started)
        time.sleep(PAUSE)
    return quantiles(seconds)


def clouds_lost(server: ServerProcess, points: Any, rate: float) -> dict[str, Any]:
    """Return how many of some clouds did not arrive, with a subscription that stays."""
    server.set_parameters(points_subscription="continuous")
    before = int(server.diagnostics()["clouds received"])
    count = round(rate * CLOUDS)
    started = time.monotonic()
    with camera_process(server, points, rate=rate, count=count) as log:
        longest = 4 * CLOUDS + STARTING
        end = time.monotonic() + longest
        while DONE not in log.read_text(errors="replace"):
            if time.monotonic() > end:
                raise TrialError(f"the camera did not send {count} clouds in {longest:g} s")
            time.sleep(0.2)
        seconds = time.monotonic() - started
        # What is on its way may still arrive, and the next line on /diagnostics tells.
        server.diagnostics()
        arrived = int(server.diagnostics()["clouds received"]) - before
    return {
        "sent": count,
        "lost": count - arrived,
        "share_lost": round((count - arrived) / count, 4),
        "seconds": round(seconds, 1),
    }


def main(signals: StopSignals | None = None) -> None:
    """Entry point of the executable `bench_node`."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=7, help="timed requests per row")
    parser.add_argument("--note", default="", help="what else the machine was doing")
    parser.add_argument("--out", type=Path, help="result file (JSON); by default printed")
    parser.add_argument("--server", nargs="+", help="command in place of grasp_server")
    arguments = parser.parse_args()

    def run() -> int:
        def tell(what: str) -> None:
            sys.stderr.write(f"{what}\n")

        record = bench(arguments.repeats, arguments.note, tell, arguments.server)
        text = json.dumps(record, indent=1) + "\n"
        if arguments.out is None:
            sys.stdout.write(text)
        else:
            arguments.out.write_text(text)
        return 0

    run_program(run, signals=signals)


if __name__ == "__main__":
    main()

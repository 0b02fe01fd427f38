"""Hours of work of grasp_server, with its memory from minute to minute.

python -m megrasp_ros.trials.soak --minutes 60 --out soak.json

A camera publishes 640 x 480 points twice a second. Requests follow each other without a break:
syntheses from the topic by service and as goals, some of which are cancelled, changes of the
gripper, requests that are refused. Exit code 1: something was not answered, failed inside the
node, or the node ended.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from megrasp_msgs.action import GenerateGrasps
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ReloadGrippers, SetGripper, SynthesizeGrasps
from rclpy import get_default_context
from rclpy.action import ActionClient

from megrasp_core.machine import processor
from megrasp_ros.process import StopSignals, run_program
from megrasp_ros.waiting import send_in_executor

from .camera import picture, region_parameters
from .malformed import malformed_request
from .server_process import STARTING, ServerProcess, camera_process, server_process

RATE = 2.0
GRIPPERS = ("robotiq_2f85", "franka_hand", "robotiq_3f")
SETTLED = 5.0
"""Minutes after which memory should not grow any more."""

ANSWER = 120.0


class Soak:
    """Sends requests and counts what becomes of them."""

    def __init__(self, server: ServerProcess, seed: int) -> None:
        self._server = server
        self._rng = np.random.default_rng(seed)
        self._action = ActionClient(server.node, GenerateGrasps, "generate_grasps")
        self._action.wait_for_server(60.0)
        self.sent = 0
        self.unanswered = 0
        self.codes: Counter[str] = Counter()
        self.seconds: list[float] = []

    def step(self) -> None:
        """Send one request and wait for its answer."""
        self.sent += 1
        kind = self.sent % 20
        if kind == 0:
            name = GRIPPERS[(self.sent // 20) % len(GRIPPERS)]
            self._note("set_gripper", self._server.call(SetGripper.Request(gripper_name=name)))
        elif kind in (5, 15):
            self._goal(cancel_after=float(self._rng.uniform(0.05, 1.5)))
        elif kind == 10:
            self._goal(cancel_after=None)
        elif kind in (3, 13):
            self._note("malformed", self._server.call(malformed_request(self._rng), ANSWER))
        else:
            started = time.monotonic()
            answer = self._server.call(SynthesizeGrasps.Request(num_grasps=20), ANSWER)
            self._note("synthesize_grasps", answer)
            self.seconds.append(time.monotonic() - started)

    def _goal(self, cancel_after: float | None) -> None:
        node, goal = self._server.node, GenerateGrasps.Goal(num_grasps=20)
        handle = send_in_executor(node, lambda: self._action.send_goal_async(goal), ANSWER)
        if handle is None or not handle.accepted:
            self._note("generate_grasps", None)
            return
        if cancel_after is not None:
            time.sleep(cancel_after)
            send_in_executor(node, handle.cancel_goal_async, ANSWER)
        answer = send_in_executor(node, handle.get_result_async, ANSWER)
        self._note("generate_grasps", answer.result if answer is not None else None)

    def _note(self, what: str, answer: Any) -> None:
        if answer is None:
            self.unanswered += 1
            return
        self.codes[f"{what} {getattr(answer, 'error_code', 0)}"] += 1

    @property
    def internal(self) -> int:
        """Answers that say that something failed inside the node."""
        return sum(
            number
            for code, number in self.codes.items()
            if int(code.split()[-1]) == ErrorCode.INTERNAL
        )


def soak(minutes: float, seed: int, note: str, every: float = 60.0) -> dict[str, Any]:
    """Return the record of `minutes` of work."""
    rows: list[dict[str, float]] = []
    with (
        server_process(region_parameters(), context=get_default_context()) as server,
        camera_process(server, picture(), rate=RATE),
    ):
        server.wait_until_active()
        # What is loaded once and kept is loaded now: all descriptions, for instance.
        server.call(ReloadGrippers.Request(), STARTING)
        work = Soak(server, seed)
        started = time.monotonic()
        row_at = started
        while server.alive and time.monotonic() - started < 60.0 * minutes:
            work.step()
            if server.alive and time.monotonic() >= row_at:
                process = psutil.Process(server.process.pid)
                rows.append(
                    {
                        "minute": round((time.monotonic() - started) / 60.0, 2),
                        "memory_mib": round(server.memory(), 1),
                        "threads": process.num_threads(),
                        "files": process.num_fds(),
                        "requests": work.sent,
                    }
                )
                row_at += every
                print(json.dumps(rows[-1]), flush=True)
        alive = server.alive
        lasted = (time.monotonic() - started) / 60.0
        cpu = server.cpu_seconds() if alive else float("nan")
    return {
        "protocol": "ros_soak",
        "minutes": round(lasted, 1),
        "seed": seed,
        "clouds_per_second": RATE,
        "requests": work.sent,
        "answers": dict(sorted(work.codes.items())),
        "unanswered": work.unanswered,
        "internal_errors": work.internal,
        "alive_at_the_end": alive,
        "synthesis_seconds": quantiles(work.seconds),
        "server_cpu_seconds": round(cpu, 1),
        "memory": growth(rows),
        "rows": rows,
        "hardware": {**processor(), "note": note},
    }


def quantiles(values: list[float]) -> dict[str, float]:
    """Return median, p95 and maximum of some seconds, and how many there are."""
    if not values:
        return {"count": 0}
    return {
        "count": len(values),
        "median": round(float(np.median(values)), 4),
        "p95": round(float(np.quantile(values, 0.95)), 4),
        "max": round(max(values), 4),
    }


def growth(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return memory at first, at last, and its growth once the node has warmed up."""
    settled = [row for row in rows if row["minute"] >= SETTLED]
    found = {"first_mib": rows[0]["memory_mib"], "last_mib": rows[-1]["memory_mib"]}
    if len(settled) > 2:
        slope, _ = np.polyfit(
            [row["minute"] for row in settled], [row["memory_mib"] for row in settled], 1
        )
        found["mib_per_hour_after_5_minutes"] = round(60.0 * float(slope), 2)
    return found


def main() -> None:
    """Run the command."""
    signals = StopSignals()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--note", default="", help="what else the machine was doing")
    parser.add_argument("--out", type=Path, help="result file (JSON); by default printed")
    arguments = parser.parse_args()

    def run() -> int:
        record = soak(arguments.minutes, arguments.seed, arguments.note)
        text = json.dumps(record, indent=1) + "\n"
        if arguments.out is None:
            sys.stdout.write(text)
        else:
            arguments.out.write_text(text)
        good = record["alive_at_the_end"]
        return int(not good or record["unanswered"] > 0 or record["internal_errors"] > 0)

    run_program(run, signals=signals)


if __name__ == "__main__":
    main()

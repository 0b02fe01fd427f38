"""Requests that no client should send, by the thousand: each is to be answered, and none to end
the node or to fail inside it.

python -m megrasp_ros.trials.malformed --requests 10000 --out malformed.json

Exit code 1: something was not answered, failed inside the node (error 302), or the node does not
serve any more afterwards.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from lifecycle_msgs.srv import ChangeState
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ReloadGrippers, SetGripper, SynthesizeGrasps
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy import get_default_context

from megrasp_core.machine import processor
from megrasp_ros.process import StopSignals, run_program
from megrasp_ros.sensor_messages import cloud_message
from megrasp_ros.server.parameter_table import TABLE

from .server_process import SERVICES, ServerProcess, server_process

ANSWER = 60.0
"""A request that is not answered after this time (s) is not answered."""

FLOATS = (0.0, -1.0, 1e-30, 1e30, 1e38, float("nan"), float("inf"), -float("inf"))
TEXTS = ("", "x", "~nosuchuser/x", "../../..", "/etc/passwd", "a\0b", "é" * 300, "x" * 100_000)
SHARE = 0.15
"""Share of the fields that are changed."""

SERVICES[ChangeState] = "grasp_server/change_state"


def malformed_request(rng: np.random.Generator) -> Any:
    """Return a request to one of the server's services with fields that make no sense."""
    kind = rng.choice(5, p=[0.6, 0.15, 0.15, 0.05, 0.05])
    if kind == 0:
        points = rng.uniform(-0.2, 0.2, (int(rng.integers(1, 200)), 3))
        request = SynthesizeGrasps.Request(num_grasps=2, timeout=0.2)
        if rng.random() < 0.9:
            request.cloud = cloud_message(points, frame="world", stamp=request.cloud.header.stamp)
        return changed(request, rng)
    if kind == 1:
        return SetGripper.Request(gripper_name=str(rng.choice(TEXTS)), dry_run=bool(kind))
    if kind == 2:
        return SetParameters.Request(parameters=[_parameter(rng) for _ in range(3)])
    if kind == 3:
        request = ChangeState.Request()
        # Smaller ones would be possible transitions of an active node.
        request.transition.id = int(rng.integers(8, 256))
        request.transition.label = str(rng.choice(TEXTS[2:]))
        return request
    return ReloadGrippers.Request()


def changed(message: Any, rng: np.random.Generator, share: float = SHARE) -> Any:
    """Change some fields of a message, those of its parts included, and return it."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            changed(value, rng, share)
        elif rng.random() < share:
            setattr(message, name, _value(kind, value, rng))
    return message


def _value(kind: str, value: Any, rng: np.random.Generator) -> Any:
    if kind in ("float", "double"):
        return float(rng.choice(FLOATS))
    if kind == "boolean":
        return not value
    if kind == "string":
        return str(rng.choice(TEXTS))
    whole = re.fullmatch(r"(u?)int(\d+)", kind)
    if whole:
        bits = int(whole.group(2)) - (not whole.group(1))
        low = 0 if whole.group(1) else -(2**bits)
        return (
            int(rng.choice([low, 2**bits - 1, 1, 7], shuffle=False))
            if bits < 63
            else (2**bits - 1)
        )
    if kind == "sequence<uint8>":
        return value[: int(rng.integers(len(value) + 1))]
    # Another sequence: some of its parts are changed, repeated or left out.
    parts = [changed(part, rng, 0.5) if hasattr(part, "get_fields_and_field_types") else part
             for part in value]  # fmt: skip
    return parts[int(rng.integers(len(parts) + 1)) :] * int(rng.integers(3))


def _parameter(rng: np.random.Generator) -> Parameter:
    name = str(rng.choice([*TABLE, "no such parameter", "", "x" * 1000]))
    value = ParameterValue(
        type=int(rng.choice([0, 1, 2, 3, 4, 6, 8, 9, 10, 200])),
        integer_value=int(rng.choice([-(2**62), -1, 2**31, 2**62])),
        double_value=float(rng.choice(FLOATS)),
        string_value=str(rng.choice(TEXTS)),
        double_array_value=[float(rng.choice(FLOATS)) for _ in range(int(rng.integers(9)))],
        string_array_value=[str(rng.choice(TEXTS)) for _ in range(int(rng.integers(3)))],
    )
    return Parameter(name=name, value=value)


def trial(server: ServerProcess, requests: int, seed: int) -> dict[str, Any]:
    """Send them one after the other and return what became of them."""
    server.wait_until_active()
    rng = np.random.default_rng(seed)
    answers: Counter[str] = Counter()
    unanswered: list[str] = []
    internal: list[str] = []
    before = server.memory()
    sent = 0
    while sent < requests and server.alive:
        request = malformed_request(rng)
        answer = server.call(request, ANSWER)
        sent += 1
        what = type(request).__name__.partition("_")[0]
        if answer is None:
            unanswered.append(f"request {sent}: {what}")
            continue
        code = getattr(answer, "error_code", None)
        answers[what if code is None else f"{what} {code}"] += 1
        if code == ErrorCode.INTERNAL:
            internal.append(f"request {sent}: {answer.error_msg}")
    return {
        "protocol": "ros_malformed",
        "requests": sent,
        "seed": seed,
        "answers": dict(sorted(answers.items())),
        "unanswered": unanswered,
        "internal_errors": internal,
        "serves_afterwards": server.alive and _serves(server),
        "memory_mib": {"before": round(before, 1), "after": round(server.memory(), 1)}
        if server.alive
        else None,
        "hardware": processor(),
    }


def _serves(server: ServerProcess) -> bool:
    """Whether a good request is answered, once all parameters are as they were."""
    server.set_parameters(
        **{
            name.replace(".", "__"): spec.default
            for name, spec in TABLE.items()
            if not spec.read_only
        }
    )
    answer = server.call(SetGripper.Request(gripper_name="robotiq_2f85"), ANSWER)
    return answer is not None and answer.success


def main() -> None:
    """Run the command."""
    signals = StopSignals()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--requests", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="result file (JSON); by default printed")
    parser.add_argument("--server", nargs="+", help="command in place of grasp_server")
    arguments = parser.parse_args()

    def run() -> int:
        context = get_default_context()
        with server_process({}, command=arguments.server, context=context) as server:
            record = trial(server, arguments.requests, arguments.seed)
        text = json.dumps(record, indent=1) + "\n"
        if arguments.out is None:
            sys.stdout.write(text)
        else:
            arguments.out.write_text(text)
        good = record["serves_afterwards"] and record["requests"] == arguments.requests
        return int(not good or bool(record["unanswered"] or record["internal_errors"]))

    run_program(run, signals=signals)


if __name__ == "__main__":
    main()

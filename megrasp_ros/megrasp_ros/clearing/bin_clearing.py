"""Node `bin_clearing`: empties a bin through the public interface only, as a cell program would.

The first gripper takes its share of the objects, then `set_gripper` and `change_tool` bring the
next one; the rules (shares, tries, giving up) are those of `megrasp_core.cell.clearing`.
Before every pick it leaves a picture of the cloud and the ranked grasps, at the end one contact
sheet and summary.json.

Exit code: 0 the run was completed, even if objects are left (the summary tells), 1 a part of the
system failed, 2 wrong parameters, 130 a signal.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import SynthesizeGrasps
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node

from megrasp_core.cell.clearing import ClearingPlan, PickRecord
from megrasp_core.storage import AttemptFolder
from megrasp_ros.client import GraspClient, GraspServerError
from megrasp_ros.conversions import box_from_message, matrix_from_pose, pose_from_matrix
from megrasp_ros.process import StopSignals, run_program
from megrasp_ros.spinning import spin

from .parameters import ClearingParameters, declare_clearing_parameters
from .pictures import ClearingPictures

TRANSIENT = (ErrorCode.BUSY, ErrorCode.NO_CLOUD, ErrorCode.STALE_CLOUD, ErrorCode.TOOL_MISMATCH)
"""Errors that pass by themselves: a job ends, a cloud or the identity of the new tool arrives."""

TRANSIENT_WAIT = 60.0
RETRY_PERIOD = 0.5
STALE_IN_A_ROW = 3
PICTURE_WAIT = 5.0


class SystemFailure(Exception):
    """A part of the system is missing, silent, or refuses what it must be able to do."""


class BinClearing:
    """One run. `print` is its output: a line per pick and a summary."""

    def __init__(self, node: Node, parameters: ClearingParameters) -> None:
        self._node = node
        self._parameters = parameters
        record = None
        if parameters.record:
            record = AttemptFolder(parameters.record, limit=parameters.record_limit * 10**6)
        self._client = GraspClient(node, timeout=parameters.call_timeout, record=record)
        self._out = Path(parameters.out)
        region = box_from_message(parameters.region)
        self._pictures = ClearingPictures(self._out, region) if parameters.pictures else None
        self._plan = ClearingPlan(
            parameters.grippers, parameters.num_objects, tries=parameters.tries
        )
        self._mounted = ""
        self._not_before = TimeMessage()
        self._stale = 0

    def run(self) -> dict[str, object]:
        """Empties the bin and returns the summary, which is also written. Raises SystemFailure."""
        self._out.mkdir(parents=True, exist_ok=True)
        started = time.monotonic()
        failure = ""
        try:
            self._client.wait_until_ready(self._parameters.ready_timeout, cell=True)
            while (gripper := self._plan.gripper) is not None:
                if gripper != self._mounted:
                    self._mount(gripper)
                self._pick(gripper)
        except (SystemFailure, GraspServerError) as error:
            failure = str(error)
            self._plan.stop(f"system failure: {failure}")
            raise SystemFailure(failure) from error
        finally:
            if not self._plan.ended:
                self._plan.stop("interrupted")
            summary = self._plan.summary() | {
                "seconds": time.monotonic() - started,
                "seed": self._parameters.seed,
                "system_failure": failure,
            }
            self._leave(summary)
        return summary

    def _mount(self, gripper: str) -> None:
        try:
            self._client.set_gripper(gripper)
        except GraspServerError as error:
            raise SystemFailure(f"set_gripper refused {gripper!r} with {error}") from error
        change = self._client.change_tool(gripper)
        if not change.success:
            raise SystemFailure(f"change_tool refused {gripper!r}: {change.message}")
        print(f"mounted {gripper}", flush=True)
        self._mounted = gripper
        self._not_before = self._node.get_clock().now().to_msg()

    def _pick(self, gripper: str) -> None:
        attempt = len(self._plan.records) + 1
        begun = time.monotonic()
        answer = self._synthesize(attempt)
        synthesis_seconds = time.monotonic() - begun
        grasps = list(answer.grasps.grasps)
        poses = [matrix_from_pose(grasp.tcp, "grasp.tcp") for grasp in grasps]
        chosen = self._plan.choose(poses) if poses else None
        picture = self._picture(attempt, gripper, answer, chosen)
        common = {
            "attempt": attempt,
            "gripper": gripper,
            "returned": len(grasps),
            "synthesis_seconds": synthesis_seconds,
            "rejected": {row.reason: int(row.count) for row in answer.rejected},
            "picture": picture,
        }
        if chosen is None:
            record = PickRecord(
                success=False,
                reason="given_up" if grasps else "no_grasp",
                removed=(),
                objects_left=self._plan.objects_left,
                **common,
            )
            self._plan.record(record, None)
        else:
            grasp = grasps[chosen]
            begun = time.monotonic()
            result = self._client.execute(answer.grasps, grasp)
            self._not_before = self._node.get_clock().now().to_msg()
            if result.error_code == ErrorCode.STALE_CLOUD and self._stale < STALE_IN_A_ROW:
                # The scene moved between the picture and the attempt; nothing was tried.
                self._stale += 1
                return
            self._stale = 0
            if result.error_code != ErrorCode.NONE:
                raise SystemFailure(
                    f"execute_grasp refused the grasp with error {result.error_code}: "
                    f"{result.error_msg}"
                )
            record = PickRecord(
                success=result.success,
                reason=result.error_msg,
                removed=tuple(result.removed),
                objects_left=int(result.objects_left),
                score=float(grasp.score),
                width=float(grasp.width),
                width_tolerance=float(grasp.width_tolerance),
                closed_width=float(result.width),
                execution_seconds=time.monotonic() - begun,
                **common,
            )
            self._plan.record(record, poses[chosen])
        print(record.line(), flush=True)
        if answer.error_code == ErrorCode.BIN_EMPTY:
            self._plan.stop("grasp_server sees an empty bin")

    def _synthesize(self, attempt: int) -> SynthesizeGrasps.Response:
        return self._plan.failures.ask(
            lambda failed: self._ask(attempt, failed),
            # A bin that is empty is no matter of what was excluded.
            lambda answer: bool(answer.grasps) or answer.error_code == ErrorCode.BIN_EMPTY,
        )

    def _ask(
        self, attempt: int, failed: Sequence[NDArray[np.float64]]
    ) -> SynthesizeGrasps.Response:
        end = time.monotonic() + TRANSIENT_WAIT
        while True:
            try:
                return self._client.synthesize(
                    num_grasps=self._parameters.num_grasps,
                    region=self._parameters.region,
                    not_before=self._not_before,
                    exclude=[pose_from_matrix(pose) for pose in failed],
                    exclude_radius=self._plan.exclude_radius,
                    seed=self._parameters.seed + attempt,
                )
            except GraspServerError as error:
                if error.code in (ErrorCode.NO_GRASP_FOUND, ErrorCode.BIN_EMPTY):
                    return error.answer
                if error.code not in TRANSIENT or time.monotonic() > end:
                    raise SystemFailure(f"synthesize_grasps failed with {error}") from error
            time.sleep(RETRY_PERIOD)

    def _picture(
        self, attempt: int, gripper: str, answer: SynthesizeGrasps.Response, chosen: int | None
    ) -> str | None:
        if self._pictures is None:
            return None
        try:
            # Nothing has moved since the cloud of the answer.
            cloud = self._client.newest_cloud(PICTURE_WAIT, after=self._not_before)
        except GraspServerError:
            return None
        return self._pictures.pick(attempt, cloud, answer.grasps, chosen, gripper)

    def _leave(self, summary: dict[str, Any]) -> None:
        if self._pictures is not None:
            summary["contact_sheet"] = self._pictures.contact_sheet(self._plan.records)
        path = self._out / "summary.json"
        path.write_text(json.dumps(summary, indent=2) + "\n")
        print(
            f"{len(summary['removed'])} of {summary['objects_at_start']} objects removed in "
            f"{summary['attempts']} picks and {summary['seconds']:.0f} s, "
            f"{summary['objects_left']} left; {summary['ended']}. {path}",
            flush=True,
        )


def main(signals: StopSignals | None = None) -> None:
    """Entry point of the executable `bin_clearing`."""
    run_program(_run, signals=signals)


def _run() -> int:
    executor = SingleThreadedExecutor()
    spinner = threading.Thread(target=_spin, args=(executor,), daemon=True)
    try:
        node = Node("bin_clearing")
        clearing = BinClearing(node, declare_clearing_parameters(node))
        executor.add_node(node)
        spinner.start()
        clearing.run()
        return 0
    except SystemFailure as error:
        get_logger("bin_clearing").fatal(str(error))
        return 1
    finally:
        executor.shutdown()
        if spinner.is_alive():
            spinner.join(timeout=5.0)


def _spin(executor: SingleThreadedExecutor) -> None:
    with contextlib.suppress(ExternalShutdownException):
        spin(executor)

"""What a request to the resident planner takes beside the same synthesis in the process (`megrasp
bench --stage serve`).
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from megrasp_core.evaluation.report import hardware
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.service import PlannerClient, PlannerError, PlannerServer
from megrasp_core.synthesizer import GraspSynthesizer

from .synthesis import CASES, BenchCase, bench_cloud

__all__ = ["bench_serving"]


def bench_serving(
    synthesizer: GraspSynthesizer,
    *,
    cases: Sequence[BenchCase] = CASES[:2],
    repeats: int = 7,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Time requests over loopback, each beside the same call in the process.

    Args:
        synthesizer: with a gripper set.
        cases: rows.
        repeats: pairs a row, after one that is not counted.
        on_progress: called with pairs done and in all.

    Returns:
        Content of the result file, seconds and CPU-seconds of the process (server and client are
        both in it): per row a request, the call in the process, and the request beyond the call;
        `transport`: a request with the whole cloud that is refused once it was read; a status.
    """
    cloud, region = bench_cloud()
    points = cloud.points.astype(np.float32)
    box = {"pose": pose7_from_matrix(region.world_from_box).tolist(), "size": region.size.tolist()}
    server = PlannerServer(synthesizer, port=0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        client = PlannerClient(server.address)
        rows = []
        for place, case in enumerate(cases):
            pairs = []
            for repeat in range(repeats + 1):
                options: dict[str, Any] = {
                    "num_grasps": case.returned, "drawn": case.drawn, "mode": case.mode,
                    "seed": repeat,
                }  # fmt: skip
                direct = _seconds(
                    lambda o=options: synthesizer.synthesize(cloud, region=region, **o)
                )
                sensor = cloud.viewpoint
                asked = _seconds(
                    lambda o=options, s=sensor: client.synthesize(
                        points, sensor=s, region=box, **o
                    )
                )
                if repeat:
                    pairs.append((asked, direct))
                if on_progress is not None:
                    on_progress(place * (repeats + 1) + repeat + 1, len(cases) * (repeats + 1))
            asked, direct = np.array(pairs).swapaxes(0, 1)
            rows.append(
                {
                    "mode": case.mode,
                    "drawn": case.drawn,
                    "returned": case.returned,
                    "request": _spread(asked),
                    "in_process": _spread(direct),
                    "beyond": _spread(asked - direct),
                }
            )
        away = {**box, "pose": [100.0, *box["pose"][1:]]}

        def refused() -> None:
            with contextlib.suppress(PlannerError):
                client.synthesize(points, sensor=cloud.viewpoint, region=away)

        transport = np.array([_seconds(refused) for _ in range(10)])
        status = np.array([_seconds(client.status) for _ in range(20)])
    finally:
        server.stop()
        thread.join()
    gripper = synthesizer.gripper
    return {
        "stage": "serve",
        "model": synthesizer.model.model_id,
        "gripper": None if gripper is None else gripper.name,
        "points": len(points),
        "body_mb": round(points.nbytes / 1e6, 2),
        "repeats": repeats,
        "rows": rows,
        "transport": _spread(transport),
        "status": _spread(status),
        "hardware": hardware(),
        "load": round(os.getloadavg()[0], 1),
    }


def _seconds(call: Callable[[], object]) -> tuple[float, float]:
    """Seconds and CPU-seconds of this process."""
    start, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - start, time.process_time() - cpu


def _spread(pairs: np.ndarray) -> dict[str, dict[str, float]]:
    """Of N pairs of seconds and CPU-seconds (N, 2)."""
    return {
        name: {
            which: round(float(np.percentile(values, q)), 4)
            for which, q in (("min", 0), ("median", 50), ("max", 100))
        }
        for name, values in zip(("seconds", "cpu_seconds"), pairs.T, strict=True)
    }

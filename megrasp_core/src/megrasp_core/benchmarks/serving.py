"""What a request to the resident planner takes beside the same synthesis in the process (`megrasp
bench --stage serve`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from megrasp_core.evaluation.report import hardware
from megrasp_core.lie import pose7_from_matrix
from megrasp_core.service import PlannerClient, PlannerServer
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
        Content of the result file: per row the seconds of a request, of the call in the process,
        and of the request beyond the call (median of the pairs); the seconds of a status.
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
            asked, direct = np.array(pairs).T
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
        status = [_seconds(client.status) for _ in range(20)]
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
        "status": _spread(status),
        "hardware": hardware(),
    }


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _spread(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    low, middle, high = (float(np.percentile(values, q)) for q in (0, 50, 100))
    return {"min": round(low, 4), "median": round(middle, 4), "max": round(high, 4)}

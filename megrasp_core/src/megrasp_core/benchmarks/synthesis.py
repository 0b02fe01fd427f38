"""Seconds, CPU-seconds and memory of a synthesis, stage by stage (`megrasp bench`)."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from megrasp_core.evaluation.report import hardware
from megrasp_core.objects import procedural_object
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.simulation import Bin, DepthNoise, TopDownCamera, observe, settle
from megrasp_core.synthesizer import GraspSynthesizer, Mode


@dataclass(frozen=True)
class BenchCase:
    """One row: `fast` draws what it returns, `default` draws `drawn` and returns `returned`."""

    mode: Mode
    drawn: int
    returned: int


CASES = (BenchCase("fast", 20, 20), BenchCase("default", 100, 20), BenchCase("fast", 100, 100))


def bench_cloud(seed: int = 5, objects: int = 10) -> tuple[Cloud, OrientedBox]:
    """One noisy top-down view of a bin with procedural objects, and the inside of the bin."""
    rng = np.random.default_rng(seed)
    models = [procedural_object(int(rng.integers(2**31))) for _ in range(objects)]
    scene = settle(models, bin=Bin(), rng=rng)
    return observe(scene.world(), TopDownCamera(), DepthNoise(), rng), Bin().region()


def bench_synthesis(
    synthesizer: GraspSynthesizer,
    *,
    cases: Sequence[BenchCase] = CASES,
    repeats: int = 7,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Time the synthesis from cloud to ranked list.

    Args:
        synthesizer: with a gripper set.
        cases: rows.
        repeats: timed calls per row, after one that is not counted.
        on_progress: called with calls done and in all.

    Returns:
        Content of the result file: per row the minimum, median and maximum of every phase (s),
        CPU-seconds of the process, peak memory (MB).
    """
    cloud, region = bench_cloud()
    rows = []
    total = len(cases) * (repeats + 1)
    for place, case in enumerate(cases):
        calls: list[dict[str, float]] = []
        result = None
        for repeat in range(repeats + 1):
            cpu = time.process_time()
            result = synthesizer.synthesize(
                cloud,
                num_grasps=case.returned,
                drawn=case.drawn,
                mode=case.mode,
                region=region,
                seed=repeat,
            )
            if repeat:
                calls.append({**result.timing, "cpu": time.process_time() - cpu})
            if on_progress is not None:
                on_progress(place * (repeats + 1) + repeat + 1, total)
        assert result is not None
        rows.append(
            {
                "mode": case.mode,
                "drawn": result.drawn,
                "returned": case.returned,
                "evaluations": result.evaluations,
                "seconds": {
                    phase: {
                        "min": round(min(c[phase] for c in calls), 4),
                        "median": round(float(np.median([c[phase] for c in calls])), 4),
                        "max": round(max(c[phase] for c in calls), 4),
                    }
                    for phase in calls[0]
                },
            }
        )
    gripper, threads = synthesizer.gripper, synthesizer.threads
    return {
        "stage": "synthesis",
        "model": synthesizer.model.model_id,
        "gripper": None if gripper is None else gripper.name,
        "device": str(synthesizer.model.device),
        "points": len(cloud.points),
        "repeats": repeats,
        "rows": rows,
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        "hardware": hardware() | ({"threads": threads} if threads else {}),
    }

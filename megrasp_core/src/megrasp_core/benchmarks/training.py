"""Poses a second in training, beside those of an older checkout, in one run (`megrasp bench
--stage training`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.errors import DataError
from megrasp_core.machine import processor

from .checkout import PRESENT, commit_of, package_of, trains_as_now

GRIPPERS_A_SCENE, POSES, LABELLED = 4, 192, 24
"""The batch: one scene, so many of its grippers, noisy and labelled poses of each."""

_NOW = """
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.training import SceneSource, TrainConfig, TrainingJob, TrainingRun, read_entries
from megrasp_core.training.processes import tuned_process
config = TrainConfig(
    scenes_per_step=1, grippers_per_scene=4, poses_per_scene=4 * POSES,
    confidence_poses=4 * LABELLED, confidence_every=EVERY, node_sets=2,
)
run = TrainingRun(TrainingJob((DATA,), DATA, compiled=COMPILED), config)
entries = [entry for entry in read_entries([DATA]).values() if entry.name in SCENES]
run._source = SceneSource(entries, config, SceneSettings())
with tuned_process():
    measure(run.step, lambda: run.counters.poses)
"""
_BEFORE_PROCESSES = """
from megrasp_core.datasets import open_scenes
from megrasp_core.training import TrainConfig
from megrasp_core.training.batching import SceneSource
from megrasp_core.training.loop import _Run
config = TrainConfig(
    grippers=GRIPPERS, poses_per_gripper=POSES, confidence_poses=LABELLED, total_seconds=1e9
)
run = _Run(DATA, config, "cpu", None)
scenes = open_scenes(DATA)
chosen = [index for index in range(len(scenes)) if scenes[index].name in SCENES]
run.source = SceneSource(scenes, config, config.network, chosen)
measure(run.step, lambda: run.counters.poses)
"""
"""For checkouts before training had processes, such as 1540005."""
_MEASURE = """
import json, sys, time
from pathlib import Path
import torch
torch.set_num_threads(1)
GIVEN = json.loads(sys.argv[1])
DATA, SCENES, GRIPPERS = Path(GIVEN["data"]), set(GIVEN["scenes"]), tuple(GIVEN["grippers"])
POSES, LABELLED = GIVEN["poses"], GIVEN["labelled"]
COMPILED, EVERY = GIVEN["compiled"], GIVEN["confidence_every"]

def measure(step, poses):
    for _ in range(GIVEN["warm"]):
        step()
    before, start = poses(), time.process_time()
    for _ in range(GIVEN["steps"]):
        step()
    print(json.dumps({"poses": poses() - before, "cpu_seconds": time.process_time() - start}))
"""


@dataclass(frozen=True)
class Contestant:
    """A trainer to be timed.

    Attributes:
        name: in the result.
        source: folder that holds the package.
        program: what is run.
        compiled: with compiled kernels.
        confidence_every: the confidence is trained in every so many steps; the older trainer does
            so in each.
    """

    name: str
    source: Path
    program: str
    compiled: bool = False
    confidence_every: int = 2


def bench_training(
    data: Path,
    against: Path,
    *,
    repeats: int = 3,
    steps: int = 12,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Time the step of preset `small` on four grippers with 192 poses each in one scene, as it is
    now with torch alone (also with as much work for the confidence as before) and with compiled
    kernels, and in an older checkout, by turns.

    Args:
        data: data set with scenes that hold grasps of four grippers.
        against: checkout to compare with.
        repeats: rounds; the median of a contestant's rounds counts.
        steps: timed a round, after twice as many that are not.
        on_progress: called with runs done and in all.

    Returns:
        Content of the result file: poses per CPU-second, and ratios to the older checkout.

    Raises:
        DataError: no such scenes, or a contestant failed.
        InvalidRequestError: `against` is no checkout.
    """
    source = package_of(against)
    contestants = [
        Contestant("before", source, _NOW if trains_as_now(source) else _BEFORE_PROCESSES),
        Contestant("torch, confidence in every step", PRESENT, _NOW, confidence_every=1),
        Contestant("torch", PRESENT, _NOW),
        Contestant("compiled", PRESENT, _NOW, compiled=True),
    ]
    scenes = _rich_scenes(data)
    found: dict[str, list[float]] = {contestant.name: [] for contestant in contestants}
    for done in range(repeats):
        for place, contestant in enumerate(contestants):
            found[contestant.name].append(_timed(contestant, data, scenes, steps))
            if on_progress is not None:
                on_progress(done * len(contestants) + place + 1, repeats * len(contestants))
    median = {name: float(np.median(rates)) for name, rates in found.items()}
    return {
        "stage": "training",
        "network": "small",
        "batch": [GRIPPERS_A_SCENE, POSES],
        "scenes": len(scenes),
        "against": commit_of(against),
        "poses_per_cpu_second": {name: [round(r, 1) for r in found[name]] for name in found},
        "ratio": {
            name: round(rate / median["before"], 3)
            for name, rate in median.items()
            if name != "before"
        },
        "hardware": processor(),
        "load": round(os.getloadavg()[0], 2),
    }


def _rich_scenes(data: Path, count: int = 6) -> list[str]:
    from megrasp_core.storage import open_scenes
    from megrasp_core.training import GRIPPERS

    names: list[str] = []
    scenes = open_scenes(data)
    for index in range(len(scenes)):
        labels = scenes[index].labels
        holding = [name for name in labels if name in GRIPPERS and (labels[name].label == 1).any()]
        if len(holding) == len(labels) == GRIPPERS_A_SCENE:
            names.append(scenes[index].name)
        if len(names) == count:
            return names
    raise DataError(
        f"{data} has {len(names)} scenes with labels of exactly {GRIPPERS_A_SCENE} grippers that "
        f"all hold something; expected {count}. Make some with `megrasp data scenes "
        f"--grippers-per-scene {GRIPPERS_A_SCENE}`."
    )


def _timed(contestant: Contestant, data: Path, scenes: Sequence[str], steps: int) -> float:
    from megrasp_core.training import GRIPPERS

    given = {
        "data": str(data.resolve()),
        "scenes": list(scenes),
        "grippers": list(GRIPPERS),
        "poses": POSES,
        "labelled": LABELLED,
        "compiled": contestant.compiled,
        "confidence_every": contestant.confidence_every,
        "steps": steps,
        "warm": 2 * steps,
    }
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE + contestant.program, json.dumps(given)],
        env={**os.environ, "PYTHONPATH": str(contestant.source)},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise DataError(
            f"the trainer {contestant.name} in {contestant.source} failed: "
            f"{done.stderr.strip().splitlines()[-1:]}; expected it to train on {data}."
        )
    result = json.loads(done.stdout.splitlines()[-1])
    return result["poses"] / result["cpu_seconds"]

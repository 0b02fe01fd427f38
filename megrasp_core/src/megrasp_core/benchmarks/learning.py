"""What a trainer has learned after so much CPU time, beside that of an older checkout (`megrasp
bench --stage learning`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from megrasp_core.errors import DataError
from megrasp_core.machine import processor

from .checkout import commit_of, package_of

GRIPPERS = ("robotiq_2f85", "franka_hand", "robotiq_3f")
"""What the older checkout trains for."""

_MEASURE = """
import json, sys
from pathlib import Path
import torch
torch.set_num_threads(1)
GIVEN = json.loads(sys.argv[1])
DATA, OUT, SECONDS = Path(GIVEN["data"]), Path(GIVEN["out"]), GIVEN["cpu_seconds"]
GRIPPERS, COMPILED = tuple(GIVEN["grippers"]), GIVEN["compiled"]

def told(counters):
    print(json.dumps({"poses": counters.poses, "cpu_seconds": counters.cpu_seconds}))
"""
_NOW = """
from megrasp_core.training import Counters, TrainConfig, TrainingJob, TrainingRun
from megrasp_core.training.processes import tuned_process
Counters.progress = lambda self, config: min(1.0, self.cpu_seconds / SECONDS)
config = TrainConfig(grippers=GRIPPERS, procedural_share=0.0, total_poses=10**9)
run = TrainingRun(TrainingJob((DATA,), OUT, compiled=COMPILED), config)
with tuned_process():
    run.go_on(lambda: False, None)
run.save()
told(run.counters)
"""
_BEFORE_PROCESSES = """
from megrasp_core.training import Counters, TrainConfig
from megrasp_core.training.loop import _Run
Counters.progress = lambda self, config: min(1.0, self.cpu_seconds / SECONDS)
config = TrainConfig(grippers=GRIPPERS, total_seconds=1e9)
run = _Run(OUT, config, "cpu", None)
run.read(DATA)
while run.counters.progress(config) < 1.0:
    run.step()
run.save()
told(run.counters)
"""
"""For checkouts before training had processes, such as 1540005."""


@dataclass(frozen=True)
class Learner:
    """A trainer, and how much CPU time it has.

    Attributes:
        name: in the result.
        source: folder that holds the package.
        program: what is run.
        cpu_seconds: of training steps, from the first to the end of its schedule.
        compiled: with compiled kernels.
    """

    name: str
    source: Path
    program: str
    cpu_seconds: float
    compiled: bool = False


def bench_learning(
    data: Path,
    validation: Path,
    against: Path,
    work: Path,
    *,
    cpu_seconds: float = 3600.0,
    share: float = 0.6,
) -> dict[str, Any]:
    """Train as an older checkout does for `cpu_seconds`, and side by side as it is done now for a
    share of that, each to the end of its schedule, and compare the losses.

    Both have the defaults of their own code, preset `small`, and one thread. Learning rates follow
    the CPU time. What comes out is validated by the present code: the same scenes, poses and
    noise for both.

    Args:
        data: one data set to train with.
        validation: data set of other objects.
        against: checkout to compare with.
        work: folder for both models; one that is finished there is not trained again.
        cpu_seconds: of the older trainer.
        share: of them, for the present one.

    Returns:
        Content of the result file: diffusion losses, all, per gripper and per band of noise.

    Raises:
        DataError: a trainer failed, or nothing validates.
        InvalidRequestError: `against` is no checkout.
    """
    source = package_of(against)
    like_this = (source / "megrasp_core" / "training" / "processes.py").exists()
    here = Path(__file__).resolve().parents[2]
    learners = [
        Learner("before", source, _NOW if like_this else _BEFORE_PROCESSES, cpu_seconds),
        Learner("now", here, _NOW, cpu_seconds * share, compiled=True),
    ]
    running = [_start(learner, data, work / learner.name) for learner in learners]
    try:
        counts = [
            _finish(learner, process, work / learner.name)
            for learner, process in zip(learners, running, strict=True)
        ]
    finally:
        for process in running:
            if process is not None:
                process.kill()
    return {
        "stage": "learning",
        "against": commit_of(against),
        "share": share,
        "learners": {
            learner.name: {**count, **_losses(work / learner.name / "model", validation)}
            for learner, count in zip(learners, counts, strict=True)
        },
        "hardware": processor(),
    }


def _start(learner: Learner, data: Path, out: Path) -> subprocess.Popen[str] | None:
    """Begin to train, unless that has been done."""
    if (out / "counts.json").exists():
        return None
    out.mkdir(parents=True, exist_ok=True)
    given = {
        "data": str(data.resolve()),
        "out": str(out.resolve()),
        "cpu_seconds": learner.cpu_seconds,
        "grippers": GRIPPERS,
        "compiled": learner.compiled,
    }
    return subprocess.Popen(
        [sys.executable, "-c", _MEASURE + learner.program, json.dumps(given)],
        env={**os.environ, "PYTHONPATH": str(learner.source)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(
    learner: Learner, process: subprocess.Popen[str] | None, out: Path
) -> dict[str, float]:
    """What it has counted when it is done."""
    kept = out / "counts.json"
    if process is not None:
        told, errors = process.communicate()
        if process.returncode:
            raise DataError(
                f"the trainer {learner.name} in {learner.source} failed: "
                f"{errors.strip().splitlines()[-1:]}; expected it to train."
            )
        kept.write_text(told.splitlines()[-1])
    return json.loads(kept.read_text())


def _losses(model: Path, validation: Path) -> dict[str, Any]:
    from megrasp_core.diffusion import NoiseSchedule
    from megrasp_core.network import load_model
    from megrasp_core.pointcloud import SceneSettings
    from megrasp_core.training import (
        GripperRack,
        TrainConfig,
        read_entries,
        validate,
        validation_pairs,
    )

    loaded = load_model(model)
    config = TrainConfig(grippers=GRIPPERS, network=loaded.config)
    entries = read_entries([validation])
    pairs = [
        pair for pair in validation_pairs(list(entries.values()), config) if pair[1] in GRIPPERS
    ]
    if not pairs:
        raise DataError(
            f"{validation} has no grasps of {', '.join(GRIPPERS)}; expected scenes that "
            "`megrasp data scenes --validation` makes."
        )
    rack = GripperRack(loaded.config.gripper_tokens)
    result = validate(
        loaded,
        entries,
        pairs,
        {name: rack.tokens(name) for name in GRIPPERS},
        config,
        SceneSettings(),
        NoiseSchedule.of(loaded.config),
        {name: rack.fold(name) for name in GRIPPERS},
    )
    return {
        "diffusion": round(result.losses["diffusion"], 4),
        "per_gripper": {name: round(loss, 4) for name, loss in result.per_gripper.items()},
        "per_band": {name: round(loss, 4) for name, loss in result.per_band.items()},
        "pairs": len(pairs),
    }

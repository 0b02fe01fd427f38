"""What a trainer has learned after so much CPU time, beside that of an older checkout (`megrasp
bench --stage learning`).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from megrasp_core.errors import DataError
from megrasp_core.jobs import code_hash
from megrasp_core.machine import processor

from .checkout import PRESENT, commit_of, package_of, trains_as_now

GRIPPERS = ("robotiq_2f85", "franka_hand", "robotiq_3f")
"""What the older checkout trains for."""

LOG = "log.txt"

_MEASURE = """
import json, sys
from pathlib import Path
import torch
torch.set_num_threads(1)
GIVEN = json.loads(sys.argv[1])
DATA, OUT, SECONDS = Path(GIVEN["data"]), Path(GIVEN["out"]), GIVEN["cpu_seconds"]
GRIPPERS, COMPILED = tuple(GIVEN["grippers"]), GIVEN["compiled"]

def progress(counters, config):
    share = min(1.0, counters.cpu_seconds / SECONDS)
    (OUT / "share").write_text(f"{share:.4f}")
    return share

def told(counters):
    counts = {"poses": counters.poses, "cpu_seconds": counters.cpu_seconds}
    (OUT / "done.json").write_text(json.dumps({"given": GIVEN, "counts": counts}))
"""
_NOW = """
from megrasp_core.training import Counters, TrainConfig, TrainingJob, TrainingRun
from megrasp_core.training.processes import tuned_process
Counters.progress = progress
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
Counters.progress = progress
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
    on_progress: Callable[[float], object] | None = None,
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
        work: folder for both models; one that is finished there with the same code, data and time
            is not trained again, any other is replaced.
        cpu_seconds: of the older trainer.
        share: of them, for the present one.
        on_progress: called every second with the share that is done of the slower one.

    Returns:
        Content of the result file: diffusion losses, all, per gripper and per band of noise.

    Raises:
        DataError: a trainer failed, or nothing validates.
        InvalidRequestError: `against` is no checkout.
    """
    source = package_of(against)
    program = _NOW if trains_as_now(source) else _BEFORE_PROCESSES
    learners = [
        Learner("before", source, program, cpu_seconds),
        Learner("now", PRESENT, _NOW, cpu_seconds * share, compiled=True),
    ]
    running = {
        learner.name: _started(learner, data, work / learner.name)
        for learner in learners
        if not _done(learner, data, work / learner.name)
    }
    try:
        while any(process.poll() is None for process in running.values()):
            if any(process.poll() for process in running.values()):
                break
            if on_progress is not None:
                on_progress(min(_share(work / name) for name in running))
            time.sleep(1.0)
    finally:
        for process in running.values():
            process.kill()
    counts = [_counts(learner, data, work / learner.name) for learner in learners]
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


def _given(learner: Learner, data: Path, out: Path) -> dict[str, Any]:
    return {
        "data": str(data.resolve()),
        "out": str(out.resolve()),
        "cpu_seconds": learner.cpu_seconds,
        "grippers": list(GRIPPERS),
        "compiled": learner.compiled,
        "code": code_hash(learner.source / "megrasp_core"),
    }


def _started(learner: Learner, data: Path, out: Path) -> subprocess.Popen[bytes]:
    """Begin to train, in a folder without what an earlier run left there."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    with (out / LOG).open("wb") as log:
        return subprocess.Popen(
            [
                sys.executable,
                "-c",
                _MEASURE + learner.program,
                json.dumps(_given(learner, data, out)),
            ],
            env={**os.environ, "PYTHONPATH": str(learner.source)},
            stdout=log,
            stderr=log,
        )


def _done(learner: Learner, data: Path, out: Path) -> dict[str, float] | None:
    """What it counted, if it is done with this data and this much time."""
    if not (out / "done.json").exists():
        return None
    found = json.loads((out / "done.json").read_text())
    return found["counts"] if found["given"] == _given(learner, data, out) else None


def _share(out: Path) -> float:
    """How much of its time it has had."""
    file = out / "share"
    # It may be read while it is written.
    return float(file.read_text() or 0.0) if file.exists() else 0.0


def _counts(learner: Learner, data: Path, out: Path) -> dict[str, float]:
    counts = _done(learner, data, out)
    if counts is None:
        last = (out / LOG).read_text(errors="replace").strip().splitlines()[-1:]
        raise DataError(
            f"the trainer {learner.name} in {learner.source} failed or was stopped: {last}; "
            f"expected it to train. Look at {out / LOG}."
        )
    return counts


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
